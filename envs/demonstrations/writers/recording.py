"""The project's own recordings (`envs.demonstrations.readers.recording`), written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py

from envs.demonstrations.episode import Episode
from envs.demonstrations.readers.recording import ARRAYS, FORMAT, FORMAT_VERSION, OPTIONAL, START
from envs.demonstrations.writers.hdf5 import whole_hdf5
from envs.demonstrations.writing import Writer


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
    with whole_hdf5(Path(path)) as file:
        file.attrs.update(
            format=FORMAT,
            format_version=FORMAT_VERSION,
            card=json.dumps(dict(card), sort_keys=True),
        )
        for index, episode in enumerate(episodes):
            _write_episode(file.create_group(f"episode_{index:05d}"), episode)


def _write_episode(group: h5py.Group, episode: Episode) -> None:
    for key in (*ARRAYS, *OPTIONAL):
        array = getattr(episode, key)
        if array is not None:
            # Shuffling puts the slowly changing exponent bytes together: a third smaller.
            chunked = {"compression": "gzip", "compression_opts": 9, "shuffle": True}
            group.create_dataset(key, data=array, **(chunked if array.ndim == 2 else {}))
    for key, vector in episode.start.items():
        group[f"{START}/{key}"] = vector
    fields = vars(episode.provenance) | {"details": dict(episode.provenance.details)}
    group.attrs["provenance"] = json.dumps(fields)


WRITER = Writer(
    form="FILE.h5 (a recording of this project)",
    fits=lambda out: Path(out).suffix.lower() == ".h5",
    # Actions stay in [-1, 1]: a recording is for this project.
    write=lambda out, episodes, card, _: write_recording(out, episodes, card),
)
