"""How large a demonstration file may be, checked before memory is taken for it."""

from __future__ import annotations

from typing import Final

MAX_FILE_BYTES: Final = 16 * 2**30
"""Of one file."""
MAX_ELEMENTS: Final = 2**29
"""Of one array: 4 GiB as float64."""
MAX_TOTAL_ELEMENTS: Final = 2**31
"""Of all arrays that one source hands over."""
FREE_BYTES: Final = 64 * 2**20
"""An array below this needs no further look."""
MAX_EXPANSION: Final = 1_100
"""Bytes that one stored byte may stand for. Deflate packs 1,032 at most, so an array that claims
more is not in the file."""
MAX_OBJECTS: Final = 2_000_000
"""Groups and arrays of one HDF5 file, members of a zip, rows' keys of a pickle."""
MAX_DEPTH: Final = 16
"""Of nested groups, dictionaries and lists."""
MAX_JSON_BYTES: Final = 64 * 2**20
"""Of a card, a provenance or a dataset's metadata."""
CHILD_SECONDS: Final = 120.0
"""For a process that opens a pickle or an HDF5 file for us. Published files take less than one."""
CHILD_BYTES: Final = 4 * 2**30
"""Address space of that process, beyond ten times the size of the file."""
