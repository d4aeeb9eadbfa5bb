"""Reads one Parquet file, in a process of its own.

A script, ``python parquet_probe.py FILE BYTES SECONDS``. Arrow's readers are C++, which a damaged
file can crash. That it reads without an error is not asked here: whoever comes after it finds and
names what is wrong.
"""

from __future__ import annotations

import contextlib
import resource
import sys

import pyarrow.parquet


def main(path: str, size: int, seconds: int) -> int:
    """Read the file ``path`` within limits of memory (bytes) and time (s of processor)."""
    for what, value in ((resource.RLIMIT_AS, size), (resource.RLIMIT_CPU, seconds)):
        with contextlib.suppress(ValueError, OSError):  # not every system lets a process do so
            resource.setrlimit(what, (value, value))
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(Exception), pyarrow.parquet.ParquetFile(path) as opened:
        for group in range(opened.num_row_groups):
            for column in opened.read_row_group(group, use_threads=False).columns:
                column.combine_chunks().validate(full=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(int, sys.argv[2:4])))
