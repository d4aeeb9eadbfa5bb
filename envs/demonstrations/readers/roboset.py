"""RoboSet's HDF5 files: a group per trial, ``Trial0`` on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from envs.demonstrations.files import open_hdf5, read_array
from envs.demonstrations.findings import Notes
from envs.demonstrations.readers.hdf5_layout import peek, read_observations, read_states
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

_TRIAL = re.compile(r"^Trial(\d+)$")


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Trials in the order of their numbers; ``env_infos/state`` holds where each begins."""
    with open_hdf5(path) as file:
        # Trial10 comes after Trial9: names are sorted by number.
        for name in sorted(filter(_TRIAL.match, file), key=lambda n: int(n.removeprefix("Trial"))):
            trial, where = file[name], f"{path}, /{name}"
            states = read_states(trial, "env_infos/state", where, schema)
            raw = RawEpisode(
                observations=read_observations(trial, "observations", where),
                actions=read_array(trial, "actions", where),
                rewards=read_array(trial, "rewards", where) if "rewards" in trial else None,
                start={key: rows[0] for key, rows in states.items()},
            )
            yield Record(raw, where)


READER = Reader(
    form="RoboSet HDF5 (Trial0/observations, actions, rewards)",
    fits=lambda path: peek(path, lambda file: any(map(_TRIAL.match, file))),
    read=read,
)
