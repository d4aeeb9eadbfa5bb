"""robomimic's HDF5 files: ``data/demo_0/{obs/*, next_obs/*, actions, rewards, dones, states}``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import open_hdf5, read_array
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.flattening import named_columns
from envs.demonstrations.readers.hdf5_layout import (
    group_names,
    peek,
    read_observations,
    read_states,
)
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

_DEMO = re.compile(r"^demo_(\d+)$")


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Demonstrations in the order of their numbers.

    ``dones`` is 1 at a success, at the end, or at both, as the file's maker chose: it tells no
    terminal state. ``next_obs`` gives the observation after the last action, where it is stored.
    """
    with open_hdf5(path) as file:
        data = file["data"]
        for name in sorted(filter(_DEMO.match, data), key=lambda n: int(n.removeprefix("demo_"))):
            demo, where = data[name], f"{path}, /data/{name}"
            if schema.terminated is None:
                notes.add(Kind.ENDS_UNTOLD, 1, where)
            states = read_states(demo, "", where, schema)
            raw = RawEpisode(
                observations=_observations(demo, where),
                actions=read_array(demo, "actions", where),
                rewards=read_array(demo, "rewards", where) if "rewards" in demo else None,
                start={key: rows[0] for key, rows in states.items()},
            )
            yield Record(raw, where)


def _observations(demo: h5py.Group, where: str) -> dict[str, Any]:
    before = _named(demo, "obs", where)
    if "next_obs" not in demo:
        return before
    after = _named(demo, "next_obs", where)
    missing = [key for key in before if key not in after or not len(after[key])]
    if missing:
        raise DemonstrationError(
            where,
            f"next_obs lacks {', '.join(missing)}",
            "Store the same arrays in obs and next_obs, or no next_obs",
        )
    return {key: np.concatenate([rows, after[key][-1:]]) for key, rows in before.items()}


def _named(demo: h5py.Group, key: str, where: str) -> dict[str, Any]:
    found = read_observations(demo, key, where)
    if not isinstance(found, dict):
        raise DemonstrationError(where, f"{key} is no group", "Expected a group of arrays by name")
    return named_columns(found, where)


READER = Reader(
    form="robomimic HDF5 (data/demo_0/obs/*, actions, rewards)",
    fits=lambda path: peek(path, lambda file: any(map(_DEMO.match, group_names(file, "data")))),
    read=read,
)
