"""Writing HDF5 files that appear complete or not at all."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from envs.whole_files import whole_file


class _Remembering(io.FileIO):
    """A file that keeps an error of writing for later.

    HDF5 goes on after a write that failed, complains at each further one, and may end the process
    when it closes the file.
    """

    failed: OSError | None = None

    def write(self, data: Any, /) -> int:
        if self.failed is None:
            try:
                _write_all(self, memoryview(data))
            except OSError as error:
                self.failed = error
        return len(data)


def _write_all(file: io.FileIO, data: memoryview) -> None:
    while data:
        data = data[io.FileIO.write(file, data) :]


@contextmanager
def whole_hdf5(path: Path) -> Iterator[h5py.File]:
    """An open HDF5 file that takes the place of ``path`` when the block ends well.

    Raises:
        OSError: it cannot be written; the error names ``path``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A crash half-way, or two processes filling one cache, must never leave a torn file behind.
    with whole_file(path) as temporary, _Remembering(temporary, "w+") as written:
        try:
            with h5py.File(written, "w") as file:
                yield file
        finally:
            if written.failed is not None:
                raise written.failed
