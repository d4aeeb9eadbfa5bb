"""The project's own recordings: whole episodes in one gzipped HDF5 file with a card.

Layout: root attributes ``format``, ``format_version`` and ``card`` (JSON); one group per episode,
``episode_00000`` on, with ``observations``, ``actions``, ``rewards``, ``terminated``, the optional
``success``, ``progress``, ``executed_actions`` and ``start/KEY``, and its provenance as the JSON
attribute ``provenance``. Actions are in [-1, 1], whatever the units of the task's environment.
Version 1, of the time when there was one task, kept the vectors of ``start`` in the episode's own
group.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.episode import Detail, Episode, Provenance
from envs.demonstrations.episode import Kind as ProvenanceKind
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import one_line, open_hdf5, read_array, read_attribute, read_json
from envs.demonstrations.findings import Notes
from envs.demonstrations.readers.hdf5_layout import peek
from envs.demonstrations.reading import FileSource, Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

FORMAT = "bc-sac-recording"
FORMAT_VERSION = 2
_VERSIONS = {"door-recording": 1, FORMAT: FORMAT_VERSION}
ARRAYS = ("observations", "actions", "rewards", "terminated")
OPTIONAL = ("success", "progress", "executed_actions")
START = "start"
_REMEDY = "Make the recording again (make record), or restore the file"


def read_card(path: str | Path) -> dict[str, Any]:
    """The card of a recording.

    Raises:
        DemonstrationError: the file is not a recording of this project.
    """
    with open_hdf5(Path(path)) as file:
        return _card(file, Path(path))


def read_recording(path: str | Path, schema: DemoSchema) -> list[Episode]:
    """All episodes of a recording, bit for bit as they were written.

    Args:
        path: file that `envs.demonstrations.writers.recording.write_recording` wrote.
        schema: of the task.

    Raises:
        DemonstrationError: the file is missing, corrupt, of another format, or fails validation.
    """
    return FileSource(READER, Path(path)).load(schema)


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Episodes in the order of their names."""
    with open_hdf5(path) as file:
        _card(file, path)
        for name in sorted(file):
            where = f"{path}, {name}"
            if not isinstance(file[name], h5py.Group):
                raise DemonstrationError(where, "is no episode", _REMEDY)
            yield _record(file[name], where, schema)


def _is_recording(file: h5py.File) -> bool:
    return file.attrs.get("format") in _VERSIONS


def _card(file: h5py.File, path: Path) -> dict[str, Any]:
    name = read_attribute(file, "format", str(path))
    if not isinstance(name, str) or name not in _VERSIONS:
        raise DemonstrationError(path, f"is not a {FORMAT} file", _REMEDY)
    version, known = read_attribute(file, "format_version", str(path)), _VERSIONS[name]
    if not isinstance(version, np.integer | int) or int(version) != known:
        raise DemonstrationError(
            path, f"has format version {version}, this code reads {known}", _REMEDY
        )
    card = read_json(read_attribute(file, "card", str(path)), str(path), "card")
    if not isinstance(card, dict):
        raise DemonstrationError(path, "has a damaged card (no object)", _REMEDY)
    return card


def _record(group: h5py.Group, where: str, schema: DemoSchema) -> Record:
    raw = RawEpisode(
        observations=read_array(group, "observations", where),
        actions=read_array(group, "actions", where),
        rewards=read_array(group, "rewards", where),
        terminated=_optional(group, "terminated", where),
        start=_start(group, where, schema),
        success=_optional(group, "success", where),
        progress=_optional(group, "progress", where),
        executed_actions=_optional(group, "executed_actions", where),
        normalised=True,
    )
    return Record(raw, where, provenance=_provenance(group, where))


def _start(group: h5py.Group, where: str, schema: DemoSchema) -> dict[str, NDArray[Any]]:
    paths = {key.name: (f"{START}/{key.name}", *key.names) for key in schema.start}
    found = {name: next((p for p in tried if p in group), None) for name, tried in paths.items()}
    return {name: read_array(group, path, where) for name, path in found.items() if path}


def _provenance(group: h5py.Group, where: str) -> Provenance:
    text = read_attribute(group, "provenance", where)
    if text is None:
        raise DemonstrationError(where, "lacks provenance", _REMEDY)
    fields = read_json(text, where, "provenance")
    try:
        found = Provenance(**fields)
        known = isinstance(found.source, str) and found.kind in get_args(ProvenanceKind)
        details = all(isinstance(value, get_args(Detail)) for value in found.details.values())
        if known and details and isinstance(found.episode, int):
            return found
    # Not an object, or an object with other keys.
    except (ValueError, TypeError) as error:
        raise DemonstrationError(
            where, f"has a damaged provenance ({one_line(error)})", _REMEDY
        ) from error
    raise DemonstrationError(where, "has a damaged provenance (values of other kinds)", _REMEDY)


def _optional(group: h5py.Group, key: str, where: str) -> NDArray[Any] | None:
    return read_array(group, key, where) if key in group else None


READER = Reader(
    form="a recording of this project (.h5)",
    fits=lambda path: peek(path, _is_recording),
    read=read,
)
