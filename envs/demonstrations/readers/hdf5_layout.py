"""What the readers of HDF5 layouts share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from envs.demonstrations import hdf5_probe
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import first_bytes, read_array, require_readable
from envs.demonstrations.schema import DemoSchema

HDF5_SUFFIXES: Final = (".h5", ".hdf5")
_SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"


def is_hdf5(path: Path) -> bool:
    """Whether a file is, or calls itself, HDF5."""
    if not path.is_file():
        return False
    if path.suffix.lower() in HDF5_SUFFIXES:
        return True
    return first_bytes(path, len(_SIGNATURE)) == _SIGNATURE


def peek(path: Path, fits: Callable[[h5py.File], bool]) -> bool:
    """Whether the layout of an HDF5 file passes ``fits``; what cannot be opened does not.

    ``fits`` may look at names and attributes, and at groups by `group_names`: nothing has been
    inspected yet, so no link may be followed.
    """
    try:
        if not is_hdf5(path):
            return False
        require_readable(path, hdf5_probe.__file__)
        with h5py.File(path, "r") as file:
            return fits(file)
    # Damage is the business of whoever reads the file, which says where it is.
    except Exception:
        return False


def group_names(file: h5py.File, key: str) -> list[str]:
    """Names below the group ``key`` of the file itself, none where there is no such group."""
    if not isinstance(file.get(key, getlink=True), h5py.HardLink):
        return []
    found = file[key]
    return list(found) if isinstance(found, h5py.Group) else []


def read_observations(group: h5py.Group, key: str, where: str) -> NDArray[Any] | dict[str, Any]:
    """An array, or a group of arrays as a mapping, of a file that has been inspected.

    Of pictures only the first row: they are refused or left out, and seeing one is enough for that.
    """
    if key in group and isinstance(group[key], h5py.Group):
        return {name: read_observations(group[key], name, f"{where}/{key}") for name in group[key]}
    if key in group and group[key].dtype == np.uint8 and group[key].ndim >= 3:
        return np.asarray(group[key][:1])
    return read_array(group, key, where)


def read_states(
    group: h5py.Group, folder: str, where: str, schema: DemoSchema
) -> dict[str, NDArray[Any]]:
    """The recorded vectors [rows, size] of the schema's ``start`` below ``folder``, by their name.

    Raises:
        DemonstrationError: one of them has no rows, or is damaged.
    """
    found = {}
    for key in schema.start:
        paths = [f"{folder}/{name}" if folder else name for name in key.names]
        path = next((p for p in paths if p in group), None)
        if path is not None:
            found[key.name] = read_array(group, path, where)
            if found[key.name].ndim != 2 or not len(found[key.name]):
                raise DemonstrationError(
                    where,
                    f"{path} has shape {list(found[key.name].shape)}, expected [T, {key.size}]",
                    "Repair the file",
                )
    return found
