"""D4RL's flat HDF5 layout, with ``next_observations`` so that no last observation is lost."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from envs.demonstrations.episode import Episode
from envs.demonstrations.matrices import in_file_units
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.writers.hdf5 import whole_hdf5
from envs.demonstrations.writing import Writer


def write_d4rl(
    path: str | Path,
    episodes: Sequence[Episode],
    card: Mapping[str, Any],
    schema: DemoSchema | None = None,
) -> None:
    """Write all episodes after one another, one row per action.

    The arrays are ``observations``, ``next_observations``, ``actions``, ``rewards``, ``terminals``
    and ``timeouts``. ``infos`` holds what every episode has: the vectors of ``start`` in each of
    its rows, ``success`` and ``progress`` after each action and ``success_at_start`` and
    ``progress_at_start``. The card is the attribute ``card`` (JSON).

    Args:
        path: file to write; its folder is created.
        episodes: at least one.
        card: JSON-serialisable facts about how they were made.
        schema: of the task, for the units of actions.

    Raises:
        OSError: the folder cannot be written.
    """
    with whole_hdf5(Path(path)) as file:
        file.attrs["card"] = json.dumps(dict(card), sort_keys=True)
        _stack(file, "observations", [e.observations[:-1] for e in episodes])
        _stack(file, "next_observations", [e.observations[1:] for e in episodes])
        _stack(file, "actions", [in_file_units(e.actions, schema) for e in episodes])
        _stack(file, "rewards", [e.rewards for e in episodes])
        _stack(file, "terminals", [e.terminated for e in episodes])
        last = [np.arange(e.length) == e.length - 1 for e in episodes]
        _stack(
            file, "timeouts", [end & ~e.terminated for end, e in zip(last, episodes, strict=True)]
        )
        for key in ("success", "progress"):
            columns = [getattr(episode, key) for episode in episodes]
            if all(column is not None for column in columns):
                _stack(file, f"infos/{key}", [column[1:] for column in columns])
                _stack(
                    file,
                    f"infos/{key}_at_start",
                    [np.repeat(column[:1], len(column) - 1) for column in columns],
                )
        for name in sorted(set.intersection(*(set(e.start) for e in episodes))):
            _stack(file, f"infos/{name}", [np.tile(e.start[name], (e.length, 1)) for e in episodes])


def _stack(file: h5py.File, key: str, arrays: Sequence[Any]) -> None:
    file.create_dataset(key, data=np.concatenate(arrays), compression="gzip", shuffle=True)


WRITER = Writer(
    form="FILE.hdf5 (D4RL's layout)",
    fits=lambda out: Path(out).suffix.lower() == ".hdf5",
    write=write_d4rl,
)
