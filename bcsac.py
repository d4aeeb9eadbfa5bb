"""One command, ``bcsac``, and the names that it needs: our packages beside a user's own.

The packages ``configs``, ``envs``, ``losses`` and ``pipeline`` have names that others use as
well, and Python takes whichever stands first on ``sys.path``: the current folder's. :func:`claim`
makes the four names ours for this process, and appends folders of the same name to our packages,
so that a user's own ``envs/my_task.py`` is still ``envs.my_task``. ``pipeline`` claims them when it
is imported.
"""

from __future__ import annotations

import os
import runpy
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from pkgutil import extend_path, iter_modules
from types import ModuleType
from typing import Final

NAMES: Final = ("configs", "envs", "losses", "pipeline")
"""Our top-level packages."""
STARTED_AS: Final = "BCSAC_STARTED_AS"
"""Variable of the environment: ``bcsac`` below :func:`main`, so that messages name its commands, in
processes that it starts too; the Makefile takes it out."""

_ROOT: Final = Path(__file__).resolve().parent
_USAGE: Final = """\
 bcsac train [KEY=VALUE]...   trains a policy; its keys: bcsac train --help
 bcsac COMMAND --help         the options of the commands below
"""


class _OurPackages(MetaPathFinder):
    """Finds our packages in our own folder, whatever stands first on ``sys.path``."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name not in NAMES:
            return None
        spec = PathFinder.find_spec(name, [str(_ROOT)], target)
        if spec is not None:
            spec.submodule_search_locations = _with_folders_of_others(name)
        return spec


def claim() -> None:
    """Makes our names ours for this process. A second call changes nothing.

    Raises:
        ImportError: If a package of others was imported under one of the names before.
    """
    if any(isinstance(finder, _OurPackages) for finder in sys.meta_path):
        return
    for name in NAMES:
        if name in sys.modules:
            _keep(name, sys.modules[name])
    sys.meta_path.insert(0, _OurPackages())


def main() -> None:
    """The command ``bcsac``: ``train`` goes to Hydra, everything else to ``pipeline.cli``."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # a script lacks it, and a user's task may lie there
    claim()
    os.environ[STARTED_AS] = "bcsac"
    if sys.argv[1:2] == ["train"]:
        del sys.argv[1]
        # As `python -m pipeline.train`, which is what Hydra asks for when it names a job.
        runpy.run_module("pipeline.train", run_name="__main__", alter_sys=True)
        return
    if sys.argv[1:] in ([], ["--help"]):
        sys.stdout.write(_USAGE)
    import_module("pipeline.cli").main()


def _keep(name: str, module: ModuleType) -> None:
    """Goes on with a package that was imported before the name was claimed, if it is ours."""
    folders = [str(Path(folder).resolve()) for folder in getattr(module, "__path__", [])]
    if folders[:1] != [str(_ROOT / name)]:
        raise ImportError(
            f"{name} was imported from {folders[0] if folders else module.__file__} before "
            f"{_ROOT / name} could be: import bcsac before it, start through the command bcsac, "
            "or give that folder another name."
        )
    module.__path__ = _with_folders_of_others(name)


def _with_folders_of_others(name: str) -> list[str]:
    """Our folder of this name, then those of others on ``sys.path`` (not other copies of ours)."""
    ours = _ROOT / name
    found = extend_path([str(ours)], name)
    others = [
        folder
        for folder in dict.fromkeys(found)
        if Path(folder).resolve() != ours
        and not (Path(folder).parent / Path(__file__).name).is_file()
    ]
    hidden = {entry.name for entry in iter_modules([str(ours)])}
    for folder in others:
        shared = sorted(hidden & {entry.name for entry in iter_modules([folder])})
        if shared:
            warnings.warn(
                f"{name}.{shared[0]} is bc-sac's: modules of the same name in {folder} are not "
                f"importable as {name}.* ({', '.join(shared)}); give them other names.",
                stacklevel=2,
            )
    return [str(ours), *others]


if __name__ == "__main__":
    import_module(Path(__file__).stem).main()  # the module that `pipeline` imports, not a copy
