"""Writing HDF5 files that appear complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py


@contextmanager
def whole_file(path: Path) -> Iterator[h5py.File]:
    """An open HDF5 file that takes the place of ``path`` when the block ends well.

    Raises:
        OSError: the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A crash half-way, or two processes filling one cache, must never leave a torn file behind.
    # Not tempfile: its files are private to their owner, and a recording is there to be shared.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with h5py.File(temporary, "w") as file:
            yield file
        with temporary.open("rb") as written:
            os.fsync(written.fileno())  # else a power cut can leave the name without the content
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
