"""Opening files of others: what they are is looked at before anything is read or allocated."""

from __future__ import annotations

import json
import os
import stat
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from envs.demonstrations import hdf5_probe, limits
from envs.demonstrations.children import run_child
from envs.demonstrations.errors import DemonstrationError
from envs.one_line import kind_and_text

DAMAGED = "It is truncated or of another format: download or record it again"


def require_regular(path: Path) -> None:
    """Raise `DemonstrationError` unless ``path`` is a plain file that is not too large.

    Opening a FIFO waits for somebody to write into it, and a device may never end.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise DemonstrationError(
            path, f"cannot be read ({error.strerror})", "Check the path in DEMOS"
        ) from error
    if not stat.S_ISREG(found.st_mode):
        raise DemonstrationError(path, "is not a plain file", "Give the file itself")
    if not os.access(path, os.R_OK):
        raise DemonstrationError(path, "cannot be read (no permission)", "Change its mode")
    if found.st_size > limits.MAX_FILE_BYTES:
        raise DemonstrationError(
            path, f"has {found.st_size:,} bytes", f"At most {limits.MAX_FILE_BYTES:,} are read"
        )


def first_bytes(path: Path, count: int) -> bytes:
    """What a plain file begins with, nothing where it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(count)
    except OSError:
        return b""


def require_elements(shape: tuple[int, ...], itemsize: int, stored: int, where: str) -> None:
    """Raise `DemonstrationError` if an array is too large, or larger than what is stored can hold.

    Args:
        shape: that the file declares.
        itemsize: bytes of one element.
        stored: bytes that the array takes in the file.
        where: file and array, for the message.
    """
    elements = 1
    for size in shape:
        elements *= size  # Python's integers do not overflow
    if elements > limits.MAX_ELEMENTS:
        raise DemonstrationError(
            where,
            f"has shape {list(shape)}",
            f"At most {limits.MAX_ELEMENTS:,} entries are read: split the file",
        )
    declared = elements * itemsize
    if declared > max(limits.FREE_BYTES, stored * limits.MAX_EXPANSION):
        raise DemonstrationError(
            where, f"declares {declared:,} bytes and holds {stored:,}", f"{DAMAGED}"
        )


def require_readable(path: Path, probe: str) -> None:
    """Raise `DemonstrationError` if reading a file crashes its library, or never ends.

    Args:
        path: of the file.
        probe: script that reads it.
    """
    require_regular(path)
    found = path.stat()
    problem = _probe(path, probe, (found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size))
    if problem is not None:
        raise problem


@lru_cache(maxsize=256)
def _probe(path: Path, probe: str, _: tuple[int, ...]) -> DemonstrationError | None:
    # Every reader of HDF5 asks, and a file that hangs must not be waited for by each.
    try:
        run_child(probe, path)
    except DemonstrationError as error:
        return error
    return None


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file whose content is all its own, or say what is wrong with it.

    Every link and array is looked at: nothing points into another file, in a circle or too deep.
    """
    require_readable(path, hdf5_probe.__file__)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise DemonstrationError(
            path, f"is not a readable HDF5 file ({one_line(error)})", DAMAGED
        ) from error
    try:
        _inspect(file, path)
    # A damaged header surfaces as whatever the library stumbles over.
    except Exception as error:
        file.close()
        if isinstance(error, DemonstrationError):
            raise
        raise DemonstrationError(
            path, f"is not a readable HDF5 file ({one_line(error)})", DAMAGED
        ) from error
    return file


def read_array(group: h5py.Group, key: str, where: str) -> NDArray[Any]:
    """Dataset ``key`` of ``group`` in memory, of numbers only.

    Raises:
        DemonstrationError: it is missing, not a dataset, too large, or its bytes are damaged.
    """
    if key not in group:
        found = ", ".join(sorted(map(str, group))) or "nothing"
        raise DemonstrationError(where, f"lacks {key} (found: {found})", DAMAGED)
    try:
        data = group[key]
        kind, shape, stored = data.dtype, data.shape, data.id.get_storage_size()
        if shape is not None and kind.kind in "fiub":
            require_elements(shape, kind.itemsize, stored, f"{where}, {key}")
            return np.asarray(data[()])
    # h5py reports a damaged chunk as OSError or RuntimeError, a group in place of data as others.
    except (OSError, RuntimeError, AttributeError, TypeError, ValueError, MemoryError) as error:
        if isinstance(error, DemonstrationError):
            raise
        raise DemonstrationError(
            where, f"cannot read {key} ({one_line(error)})", DAMAGED
        ) from error
    raise DemonstrationError(where, f"{key} has dtype {kind}", "Store real numbers, e.g. float32")


def require_hdf5_elements(file: h5py.File, where: str) -> None:
    """Raise `DemonstrationError` if any array of an inspected file is too large to be read."""

    def check(name: str, found: Any) -> None:
        if isinstance(found, h5py.Dataset) and found.shape is not None:
            stored = found.id.get_storage_size()
            require_elements(found.shape, found.dtype.itemsize, stored, f"{where}, {name}")

    file.visititems(check)


def read_attribute(holder: h5py.Group, key: str, where: str) -> Any:
    """Attribute ``key``, None where there is none.

    Raises:
        DemonstrationError: it cannot be read.
    """
    try:
        return holder.attrs.get(key)
    except Exception as error:
        raise DemonstrationError(
            where, f"cannot read the attribute {key} ({one_line(error)})", DAMAGED
        ) from error


def read_json(text: object, where: str, what: str) -> Any:
    """JSON of an attribute or a metadata file.

    Raises:
        DemonstrationError: it is not text, too long, or no JSON.
    """
    if not isinstance(text, str | bytes) or len(text) > limits.MAX_JSON_BYTES:
        raise DemonstrationError(where, f"has a damaged {what}", DAMAGED)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DemonstrationError(
            where, f"has a damaged {what} ({one_line(error)})", DAMAGED
        ) from error


def read_json_file(path: Path, what: str) -> Any:
    """A metadata file; see `read_json`."""
    require_regular(path)
    if path.stat().st_size > limits.MAX_JSON_BYTES:
        raise DemonstrationError(path, f"has a damaged {what} (too long)", DAMAGED)
    return read_json(path.read_bytes(), str(path), what)


def read_npz(path: Path | IO[bytes], where: str) -> dict[str, NDArray[Any]]:
    """All arrays of an npz file; pickled objects are refused.

    Args:
        path: of the file, or the open file.
        where: its name, for messages.

    Raises:
        DemonstrationError: the file is damaged, or an array is too large or holds no numbers.
    """
    if isinstance(path, Path):
        require_regular(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > limits.MAX_OBJECTS:
                raise DemonstrationError(where, f"holds {len(members):,} arrays", DAMAGED)
            for member in members:
                _require_npy(archive, member, where)
        if not isinstance(path, Path):
            path.seek(0)
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except DemonstrationError:
        raise
    # zipfile, zlib and numpy's header parser each have their own words for damage.
    except Exception as error:
        raise DemonstrationError(
            where, f"is not a readable npz file ({one_line(error)})", DAMAGED
        ) from error


def one_line(error: BaseException) -> str:
    """Kind and text of somebody else's exception, short enough for a message."""
    return kind_and_text(error, most=200)


def _require_npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo, where: str) -> None:
    place = f"{where}, {member.filename}"
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        readers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        if version not in readers:
            raise DemonstrationError(place, f"is of npy version {version}", "Save it with numpy")
        shape, _, dtype = readers[version](stream)
    if dtype.kind not in "fiub":
        raise DemonstrationError(place, f"has dtype {dtype}", "Store real numbers, e.g. float32")
    require_elements(shape, dtype.itemsize, member.compress_size, place)
    if int(np.prod(shape, dtype=object)) * dtype.itemsize > member.file_size:
        raise DemonstrationError(place, f"is shorter than its shape {list(shape)}", DAMAGED)


def _inspect(file: h5py.File, path: Path) -> None:
    """Walk every link of an HDF5 file; h5py itself would follow them wherever they lead."""
    waiting, seen = [(file["/"], "", 0)], set()
    while waiting:
        group, name, depth = waiting.pop()
        for key in group:
            place = f"{path}, {name}/{key}"
            found = _followed(group, key, place)
            if found is None or found.id in seen:
                continue
            seen.add(found.id)
            if len(seen) > limits.MAX_OBJECTS or depth >= limits.MAX_DEPTH:
                raise DemonstrationError(
                    place, f"lies {depth + 1} levels deep, behind {len(seen):,} objects", DAMAGED
                )
            if isinstance(found, h5py.Group):
                waiting.append((found, f"{name}/{key}", depth + 1))
            elif isinstance(found, h5py.Dataset):
                _require_own(found, place)


def _followed(group: h5py.Group, key: str, place: str) -> Any:
    link = group.get(key, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        raise DemonstrationError(
            place, f"is a link into another file ({link.filename!r})", "Copy the data into the file"
        )
    try:
        return group[key]
    except Exception as error:
        raise DemonstrationError(
            place, f"leads nowhere ({one_line(error)})", "Remove the link, or restore the file"
        ) from error


def _require_own(data: h5py.Dataset, place: str) -> None:
    if data.is_virtual or data.external:
        raise DemonstrationError(
            place, "keeps its data in another file", "Copy the data into the file"
        )
    if h5py.check_ref_dtype(data.dtype) is not None:
        raise DemonstrationError(place, "holds references", "Store the numbers themselves")
