"""Writing HDF5 files that appear complete or not at all."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py


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
def whole_file(path: Path) -> Iterator[h5py.File]:
    """An open HDF5 file that takes the place of ``path`` when the block ends well.

    Raises:
        OSError: it cannot be written; the error names ``path``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A crash half-way, or two processes filling one cache, must never leave a torn file behind.
    # Not tempfile: its files are private to their owner, and a recording is there to be shared.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with _Remembering(temporary, "w+") as written:
            try:
                with h5py.File(written, "w") as file:
                    yield file
            finally:
                if written.failed is not None:
                    raise written.failed
            os.fsync(written.fileno())  # else a power cut can leave the name without the content
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is None or str(error.filename) not in ("None", str(temporary)):
            raise  # of HDF5 itself, or of what the block reads
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
