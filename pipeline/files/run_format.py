"""What a run directory may hold, checked before anything of it is read.

Run directories travel: people evaluate policies of others. TorchRL's checkpoints and TensorDict's
memory maps have forms whose reading can run code (pickles, archives that hold them, classes named
in metadata) or reach any file (links, paths in a manifest). This project writes none of them, so
whatever is not of its own few forms is refused, by name and before a byte of it is interpreted.
"""

from __future__ import annotations

import json
import logging
import math
import re
import stat
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, Final

import torch

from pipeline.files.run_files import CHECKPOINTS
from pipeline.files.sums import SUMS, DamagedError, verify_sums

_logger = logging.getLogger(__name__)

MANIFEST: Final = "manifest.json"
NAME: Final = re.compile(r"checkpoint-\d+")
COMPONENT: Final = re.compile(r"components/\d+-[\w.]+")
FILES: Final = (
    re.compile(r"(manifest|sums)\.json"),
    re.compile(r"components/\d+-[\w.]+/(state|writer)\.json"),
    re.compile(r"components/\d+-[\w.]+/(state|rows)/([\w]+/)*(meta\.json|[\w]+\.memmap)"),
)
"""Files of a checkpoint, by their path within it."""
FOLDERS: Final = (
    re.compile(r"components(/\d+-[\w.]+(/(state|rows)(/\w+)*)?)?"),
)  # fmt: skip
META: Final = "meta.json"
KINDS: Final = frozenset({"<class 'tensordict._td.TensorDict'>"})
"""Classes that a ``meta.json`` may name: others are containers of Python objects."""
KEY: Final = re.compile(r"\w+")
SUMMED: Final = "sums"
"""Key of a manifest's metadata: the name of the file with the checksums of the checkpoint."""
META_BYTES: Final = 16 * 2**20
_OWN: Final = "use the original: this project writes no such thing, and reading it could run code"


class RunFormatError(ValueError):
    """A run directory holds something that this project does not write."""


def latest_of(run_dir: Path) -> Path | None:
    """The newest checkpoint of a run that is whole, verified; None if there is none at all.

    A damaged one is told in a warning, and the one before it is taken.

    Raises:
        RunFormatError: If something else stands where checkpoints are, or see
            :func:`verify_checkpoint`.
        DamagedError: If all are damaged.
    """
    found = _checkpoints(run_dir)
    for place in range(len(found) - 1, -1, -1):
        try:
            verify_checkpoint(found[place])
        except DamagedError as error:
            if place == 0:
                raise DamagedError(
                    f"{error}; no checkpoint of {run_dir} is whole: restore one from a copy, or "
                    "train again"
                ) from error
            _logger.warning(
                "%s; %s is damaged, and %s is used in its place",
                error, found[place].name, found[place - 1].name,
            )  # fmt: skip
        else:
            return found[place]
    return None


def verify_checkpoint(path: Path) -> None:
    """Looks at every name, type, size and checksum in a checkpoint; changes and interprets nothing.

    Raises:
        RunFormatError: If it holds a link, a file that is no regular one or of another name, a
            manifest that leads elsewhere, or a description that asks for more than tensors.
        DamagedError: If a file is missing or not as it was written.
    """
    _require_folder(path)
    for entry, name in _entries(path):
        mode = entry.lstat().st_mode
        if stat.S_ISDIR(mode):
            known = any(form.fullmatch(name) for form in FOLDERS)
        elif stat.S_ISREG(mode):
            known = any(form.fullmatch(name) for form in FILES)
        else:
            raise RunFormatError(f"{entry}: is a link or a special file; {_OWN}")
        if not known:
            raise RunFormatError(f"{entry}: does not belong to a checkpoint; {_OWN}")
    summed = (path / SUMS).is_file()
    if summed:
        verify_sums(path)
    manifest = _verify_manifest(path)
    if not summed and SUMMED in manifest.get("metadata", {}):
        raise DamagedError(f"{path / SUMS}: is missing")
    for described in sorted(path.rglob(META)):
        _verify_meta(described)


def require_plain(path: Path) -> Path:
    """The path, if it is a regular file and no link.

    Raises:
        FileNotFoundError: If there is none.
        RunFormatError: If it is something else.
    """
    if not stat.S_ISREG(path.lstat().st_mode):
        raise RunFormatError(f"{path}: is a link or a special file; {_OWN}")
    return path


def _checkpoints(run_dir: Path) -> list[Path]:
    """Folders of checkpoints, from old to new."""
    folder = run_dir / CHECKPOINTS
    if not folder.is_dir() and not folder.is_symlink():
        return []
    _require_folder(folder)
    found = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue  # what a killed run had not finished
        if not NAME.fullmatch(entry.name):
            raise RunFormatError(f"{entry}: only folders checkpoint-NUMBER belong here; {_OWN}")
        _require_folder(entry)
        found.append(entry)
    return found


def _entries(path: Path) -> Iterator[tuple[Path, str]]:
    for entry in sorted(path.iterdir()):
        yield entry, entry.name
        if entry.is_dir() and not entry.is_symlink():
            yield from ((inner, f"{entry.name}/{name}") for inner, name in _entries(entry))


def _require_folder(path: Path) -> None:
    if not stat.S_ISDIR(path.lstat().st_mode):
        raise RunFormatError(f"{path}: is a link or no folder; {_OWN}")


def _verify_meta(path: Path) -> None:
    described = _read(path)
    kind = described.get("_type")
    if kind not in KINDS:
        raise RunFormatError(f"{path}: describes a {kind!r}; {_OWN}")
    for key, entry in described.items():
        if not isinstance(entry, dict):
            continue
        if not _is_tensor_or_folder(entry, key):
            raise RunFormatError(f"{path}: describes {key!r} as more than a tensor; {_OWN}")
        if entry.get("type") is not None:
            if not (path.parent / key).is_dir():
                raise DamagedError(f"{path.parent / key}: is missing")
        else:
            _verify_size(path.parent / f"{key}.memmap", entry, path)


def _is_tensor_or_folder(entry: dict[str, Any], key: str) -> bool:
    if not KEY.fullmatch(key):
        return False
    if entry.get("type") is not None:
        return str(entry["type"]) in {"TensorDict", *KINDS}
    return entry.get("is_nested") is False and {"dtype", "shape"} <= entry.keys()


def _verify_size(path: Path, entry: dict[str, Any], described_in: Path) -> None:
    """A shorter file would be made longer, with zeros, by reading it."""
    dtype = getattr(torch, str(entry["dtype"]).removeprefix("torch."), None)
    shape = entry["shape"]
    sizes = isinstance(shape, list) and all(isinstance(n, int) and n >= 0 for n in shape)
    if not isinstance(dtype, torch.dtype) or not sizes:
        raise DamagedError(f"{described_in}: describes {path.name} as no tensor")
    wanted = math.prod(shape) * dtype.itemsize
    if not path.is_file() and wanted > 0:  # of a tensor without entries none is written
        raise DamagedError(f"{path}: is missing")
    held = path.stat().st_size if wanted > 0 else 0
    if held != wanted:
        raise DamagedError(f"{path}: holds {held} bytes, and a tensor of {wanted} was written")


def _verify_manifest(path: Path) -> dict[str, Any]:
    where = path / MANIFEST
    manifest = _read(where)
    components, metadata = manifest.get("components"), manifest.get("metadata", {})
    if not isinstance(components, dict) or not isinstance(metadata, dict):
        raise DamagedError(f"{where}: lists no components")
    for name, record in components.items():
        folder = record.get("path") if isinstance(record, dict) else None
        if not isinstance(folder, str) or COMPONENT.fullmatch(folder) is None:
            raise RunFormatError(
                f"{where}: component {name!r} lies at {folder!r}, which is no folder of this "
                f"checkpoint; {_OWN}"
            )
        _verify_files(path / PurePosixPath(folder), record.get("files"), where)
    return manifest


def _verify_files(folder: Path, listed: Any, listed_in: Path) -> None:
    """Exactly the files are there that TorchRL's manifest lists: a column may be missing else."""
    if not isinstance(listed, list):
        raise DamagedError(f"{listed_in}: lists no files of {folder.name}")
    held = {entry.relative_to(folder).as_posix() for entry in folder.rglob("*") if entry.is_file()}
    for name in sorted(set(map(str, listed)) ^ held):
        if name in held:
            raise DamagedError(f"{folder / name}: is not listed in {listed_in.name}")
        raise DamagedError(f"{folder / name}: is missing")


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise DamagedError(f"{path}: is missing")
    if path.lstat().st_size > META_BYTES:
        raise DamagedError(f"{path}: is larger than any that this project writes")
    try:
        content = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path}: is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise DamagedError(f"{path}: holds no object")
    return content
