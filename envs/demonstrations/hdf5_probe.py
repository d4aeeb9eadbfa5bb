"""Touches everything in one HDF5 file, in a process of its own.

A script, ``python hdf5_probe.py FILE BYTES SECONDS``. The HDF5 library trusts the addresses in a
file, and a damaged one can crash whoever reads it. That it reads without an error is not asked
here: whoever comes after it finds and names what is wrong.
"""

from __future__ import annotations

import contextlib
import resource
import sys

import h5py

WHOLE = 2**24
"""Arrays of so many entries are read whole, of larger ones the first row and the last."""


def touch(holder: h5py.Group | h5py.Dataset) -> None:
    """Read the attributes and the data of one object."""
    for key in holder.attrs:
        with contextlib.suppress(Exception):
            holder.attrs[key]
    if isinstance(holder, h5py.Dataset) and not holder.external and not holder.is_virtual:
        if holder.size is not None and holder.size <= WHOLE:
            holder[()]
        elif holder.shape:
            holder[:1], holder[-1:]


def main(path: str, size: int, seconds: int) -> int:
    """Touch the file ``path`` within limits of memory (bytes) and time (s of processor)."""
    for what, value in ((resource.RLIMIT_AS, size), (resource.RLIMIT_CPU, seconds)):
        with contextlib.suppress(ValueError, OSError):  # not every system lets a process do so
            resource.setrlimit(what, (value, value))
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        waiting, seen = [file["/"]], set()
        while waiting:
            group = waiting.pop()
            with contextlib.suppress(Exception):
                touch(group)
            if group.id in seen or not isinstance(group, h5py.Group):
                continue
            seen.add(group.id)
            for key in group:
                with contextlib.suppress(Exception):
                    # Links are not followed: they lead to what is seen anyway, or out of the file.
                    if isinstance(group.get(key, getlink=True), h5py.HardLink):
                        waiting.append(group[key])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(int, sys.argv[2:4])))
