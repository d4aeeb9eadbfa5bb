"""What is said of a disk that is full."""

from __future__ import annotations

import errno

FULL = (errno.ENOSPC, errno.EDQUOT)


def is_full(error: OSError) -> bool:
    """Whether there was no room, on the disk or in a quota."""
    return error.errno in FULL


def where_and_what(error: OSError) -> str:
    """The file, where the error knows it, and what went wrong there."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def with_remedy(error: OSError) -> str:
    """The error in one line, with the remedy if the disk is full."""
    if not is_full(error):
        return str(error)
    return f"{where_and_what(error)}: free some space there, and run this again."
