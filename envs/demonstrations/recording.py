"""The project's own recordings: whole episodes in one gzipped HDF5 file with a card.

Layout: root attributes ``format``, ``format_version`` and ``card`` (JSON); one group per episode,
``episode_00000`` on, with ``observations``, ``actions``, ``rewards``, ``terminated``, the optional
``door_position``, ``initial_qpos``, ``initial_qvel``, and its provenance as the JSON attribute
``provenance``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.validation import RawEpisode, build_episode, require_keys

FORMAT = "door-recording"
FORMAT_VERSION = 1
_ARRAYS = ("observations", "actions", "rewards", "terminated")
_OPTIONAL = ("door_position", "initial_qpos", "initial_qvel")
_REMEDY = "Make the recording again (make record), or restore the file"


def write_recording(path: str | Path, episodes: Sequence[Episode], card: Mapping[str, Any]) -> None:
    """Write episodes and their card; the file appears complete or not at all.

    Args:
        path: file to write, usually ``*.h5``; its folder is created.
        episodes: at least one episode.
        card: JSON-serialisable facts about the recording (how it was made, from what, statistics).

    Raises:
        ValueError: there are no episodes.
        OSError: the folder cannot be written.
    """
    if not episodes:
        raise ValueError(f"{path}: refusing to write a recording without episodes")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # A crash half-way, or two processes filling one cache, must never leave a torn file behind.
    # Not tempfile: its files are private to their owner, and a recording is there to be shared.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with h5py.File(temporary, "w") as file:
            file.attrs.update(
                format=FORMAT,
                format_version=FORMAT_VERSION,
                card=json.dumps(dict(card), sort_keys=True),
            )
            for index, episode in enumerate(episodes):
                _write_episode(file.create_group(f"episode_{index:05d}"), episode)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_card(path: str | Path) -> dict[str, Any]:
    """The card of a recording.

    Raises:
        DemonstrationError: the file is not a recording of this project.
    """
    with open_hdf5(Path(path)) as file:
        return _card(file, Path(path))


def read_recording(path: str | Path) -> list[Episode]:
    """All episodes of a recording, bit for bit as they were written.

    Raises:
        DemonstrationError: the file is missing, corrupt, of another format, or fails validation.
    """
    path = Path(path)
    with open_hdf5(path) as file:
        _card(file, path)
        return [_read_episode(file[name], f"{path}, {name}") for name in sorted(file)]


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading, or say what is wrong with it."""
    try:
        return h5py.File(path, "r")
    except FileNotFoundError as error:
        raise DemonstrationError(path, "does not exist", "Check the path in DEMOS") from error
    except OSError as error:
        raise DemonstrationError(
            path,
            f"is not a readable HDF5 file ({error})",
            "It is truncated or of another format: download or record it again",
        ) from error


def read_array(group: h5py.Group, key: str, where: str) -> np.ndarray:
    """Dataset ``key`` of ``group`` in memory.

    Raises:
        DemonstrationError: it is missing, not a dataset, or its bytes are damaged.
    """
    require_keys(group, (key,), where, _REMEDY)
    try:
        return np.asarray(group[key][()])
    # h5py reports a damaged chunk as OSError or RuntimeError, a group in place of data as others.
    except (OSError, RuntimeError, AttributeError, TypeError) as error:
        raise DemonstrationError(where, f"cannot read {key} ({error})", _REMEDY) from error


def _card(file: h5py.File, path: Path) -> dict[str, Any]:
    if file.attrs.get("format") != FORMAT:
        raise DemonstrationError(path, f"is not a {FORMAT} file", _REMEDY)
    if file.attrs["format_version"] != FORMAT_VERSION:
        raise DemonstrationError(
            path,
            f"has format version {file.attrs['format_version']}, this code reads {FORMAT_VERSION}",
            _REMEDY,
        )
    try:
        return dict(json.loads(file.attrs["card"]))
    except (KeyError, ValueError, TypeError) as error:
        raise DemonstrationError(path, f"has a damaged card ({error})", _REMEDY) from error


def _write_episode(group: h5py.Group, episode: Episode) -> None:
    for key in (*_ARRAYS, *_OPTIONAL):
        array = getattr(episode, key)
        if array is not None:
            # Shuffling puts the slowly changing exponent bytes together: a third smaller.
            chunked = {"compression": "gzip", "compression_opts": 9, "shuffle": True}
            group.create_dataset(key, data=array, **(chunked if array.ndim == 2 else {}))
    fields = vars(episode.provenance) | {"details": dict(episode.provenance.details)}
    group.attrs["provenance"] = json.dumps(fields)


def _read_episode(group: h5py.Group, where: str) -> Episode:
    require_keys(group.attrs, ("provenance",), where, _REMEDY)
    raw = RawEpisode(
        observations=read_array(group, "observations", where),
        actions=read_array(group, "actions", where),
        rewards=read_array(group, "rewards", where),
        door_position=_optional(group, "door_position", where),
        qpos=_optional(group, "initial_qpos", where),
        qvel=_optional(group, "initial_qvel", where),
    )
    return build_episode(raw, _provenance(group.attrs["provenance"], where), where)


def _provenance(text: str, where: str) -> Provenance:
    try:
        return Provenance(**json.loads(text))
    # Not JSON, not an object, or an object with other keys.
    except (ValueError, TypeError) as error:
        raise DemonstrationError(where, f"has a damaged provenance ({error})", _REMEDY) from error


def _optional(group: h5py.Group, key: str, where: str) -> np.ndarray | None:
    return read_array(group, key, where) if key in group else None
