"""Files that are there whole or not at all: after a crash, beside a reader, after a power cut."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def whole_file(path: Path, suffix: str = ".tmp") -> Iterator[Path]:
    """A name to write to, whose file takes the place of ``path`` when the block ends well.

    Its folder must exist. Several processes may write one ``path``: the last one counts.

    Args:
        path: The file.
        suffix: Of the name, for libraries that go by it.

    Raises:
        OSError: If it cannot be written; where the system names no other file, it names ``path``.
    """
    # Not tempfile: its files are private to their owner, and others are to read these.
    temporary = path.with_name(f".{path.name}.{os.getpid()}{suffix}")
    try:
        yield temporary
        flush(temporary)  # else a power cut can leave the name without the content
        temporary.replace(path)
    except OSError as error:
        # What HDF5 raises itself has no number. A write that finds no room names no file, and the
        # temporary's name would help nobody.
        if error.errno is None or error.filename not in (None, str(temporary), temporary):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def whole_set(folder: Path) -> Iterator[Path]:
    """An empty folder, whose files come into ``folder`` together when the block ends well.

    Those of the same name are replaced, others stay; a block that fails leaves all as it was.

    Args:
        folder: Made if needed.

    Raises:
        OSError: If they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # In it, so that moving them there only gives names.
    with TemporaryDirectory(dir=folder, prefix=".", suffix=".made") as made:
        yield Path(made)
        for path in sorted(Path(made).rglob("*")):
            if path.is_file():
                destination = folder / path.relative_to(made)
                destination.parent.mkdir(parents=True, exist_ok=True)
                path.replace(destination)


def flush(path: Path) -> None:
    """Has the system write a file, or the names in a folder, through to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
