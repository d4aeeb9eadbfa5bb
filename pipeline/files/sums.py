"""Size and checksum of every file of a folder, written with it and looked at before it is read.

A memory map that lost its end is read as zeros, and a flipped bit as another number: only a sum
that was taken when the file was written tells. It protects from damage, not from people, who would
write other sums; what a stranger's folder may hold is looked at in
``pipeline/files/run_format.py``.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import shutil
import uuid
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from envs.whole_files import flush

SUMS: Final = "sums.json"
SUMS_BYTES: Final = 16 * 2**20
_THREADS: Final = 8
"""Most of them wait for the disk."""
_libc: Final = ctypes.CDLL(None, use_errno=True)
_syncfs: Final[Callable[[int], int] | None] = getattr(_libc, "syncfs", None)
"""Of the C library, which Python does not offer; None where there is none (macOS)."""
_renameat2: Final[Callable[[int, bytes, int, bytes, int], int] | None] = getattr(
    _libc, "renameat2", None
)
_HERE: Final = -100  # AT_FDCWD
_EXCHANGE: Final = 2  # RENAME_EXCHANGE


class DamagedError(ValueError):
    """A file is not as it was written; the message names it."""


def write_sums(folder: Path) -> None:
    """Writes ``sums.json`` over all files below ``folder``, and everything through to the disk."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    entries = {_name(path, folder): [path.stat().st_size, _sum(path)] for path in files}
    text = json.dumps({"algorithm": "crc32", "files": entries}, indent=0)
    (folder / SUMS).write_text(text)
    flush_below(folder)


def verify_sums(folder: Path) -> None:
    """Compares every file below ``folder`` with its ``sums.json``; opens files to read them only.

    Raises:
        DamagedError: If a file is missing, was added, or is not as it was written.
    """
    written = _read_sums(folder / SUMS)
    found = {_name(path, folder): path for path in folder.rglob("*") if path.is_file()}
    del found[SUMS]
    for name in sorted(written.keys() - found.keys()):
        raise DamagedError(f"{folder / name}: is missing")
    for name in sorted(found.keys() - written.keys()):
        raise DamagedError(f"{found[name]}: was not there when {SUMS} was written")
    for name, (size, total) in sorted(written.items()):
        held = found[name].stat().st_size
        if held != size:
            raise DamagedError(f"{found[name]}: holds {held} bytes, and {size} were written")
        if _sum(found[name]) != total:
            raise DamagedError(f"{found[name]}: is not as it was written (another checksum)")


def replace_folder(made: Path, destination: Path) -> None:
    """Gives ``made`` the name ``destination`` and removes what had it; both lie in one folder.

    On Linux there is one of the two under that name at every moment: a run may keep no other
    checkpoint. File systems that cannot exchange names have none for the time between two renames.
    """
    before = None
    if destination.exists():
        before = made
        if not _exchanged(made, destination):
            before = destination.with_name(f".{destination.name}.{uuid.uuid4().hex}.replaced")
            destination.rename(before)
            made.rename(destination)
    else:
        made.rename(destination)
    flush(destination.parent)
    if before is not None:
        shutil.rmtree(before, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Gives two files or folders each other's names at once, where the system can."""
    if _renameat2 is None:
        return False
    return _renameat2(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0


def flush_below(folder: Path) -> None:
    """Has the system write a folder and all that is in it through to the disk.

    On Linux in one call for the whole file system: one for each of a checkpoint's hundreds of small
    files waits for the disk as often.

    Raises:
        OSError: If something could not be written.
    """
    if _syncfs is None:
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(flush, [folder, *folder.rglob("*")]))
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        if _syncfs(handle) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(folder))
    finally:
        os.close(handle)


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _sum(path: Path) -> int:
    # CRC-32 finds damage as well as a cryptographic hash does, at four times the speed.
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size == 0:  # which cannot be mapped
            return zlib.crc32(b"")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return zlib.crc32(content)


def _read_sums(path: Path) -> dict[str, tuple[int, int]]:
    if not path.is_file():
        raise DamagedError(f"{path}: is missing")
    if path.stat().st_size > SUMS_BYTES:
        raise DamagedError(f"{path}: is larger than any that this project writes")
    try:
        files: dict[str, Any] = json.loads(path.read_bytes())["files"]
        return {name: (int(size), int(total)) for name, (size, total) in files.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedError(f"{path}: is no list of checksums ({type(error).__name__})") from error
