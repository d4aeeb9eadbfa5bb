"""One module for each format that demonstrations are written in, chosen by the form of the name."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.writing import Writer


@cache
def find_writers() -> tuple[Writer, ...]:
    """Every writer of this package, in the order of its modules' names."""
    modules = (
        import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)
    )
    return tuple(module.WRITER for module in modules if hasattr(module, "WRITER"))


def find_writer(out: str | Path) -> Writer:
    """The writer of what ``out`` names, to be asked before episodes are made.

    Raises:
        DemonstrationError: no format is written under such a name, or its package is missing.
    """
    found = next((writer for writer in find_writers() if writer.fits(str(out))), None)
    if found is None:
        forms = ", ".join(writer.form for writer in find_writers())
        raise DemonstrationError(f"OUT={out}", "names no format that is written", f"Use {forms}")
    found.ready(str(out))
    return found


def write_demonstrations(
    out: str | Path,
    episodes: Sequence[Episode],
    card: Mapping[str, Any],
    schema: DemoSchema | None = None,
) -> None:
    """Write episodes in the format that ``out`` names.

    Args:
        out: ``FILE.h5`` (a recording of this project), ``FILE.hdf5`` (D4RL's layout) or
            ``minari:ID``.
        episodes: at least one.
        card: JSON-serialisable facts about how they were made.
        schema: of the task, for the units of actions in formats that others read; None is [-1, 1].

    Raises:
        DemonstrationError: no format is written under such a name, or it cannot hold the episodes.
        ValueError: there are no episodes.
        OSError: the place cannot be written.
    """
    writer = find_writer(out)
    if not episodes:
        raise ValueError(f"{out}: refusing to write demonstrations without episodes")
    writer.write(str(out), episodes, card, schema)
