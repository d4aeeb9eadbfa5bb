"""HDF5 demonstrations: the project's own recordings, D4RL's flat files and RoboSet's trials."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.recording import FORMAT, open_hdf5, read_array, read_recording
from envs.demonstrations.validation import RawEpisode, build_episode, require_keys
from envs.door import task

_LAYOUTS = (
    "Expected a recording of this project, D4RL's flat arrays (observations, actions, rewards, "
    "terminals, timeouts) or RoboSet's Trial groups"
)
_TRIAL = re.compile(r"^Trial(\d+)$")
#: Between two observations of one episode the door and its handle move by millimetres; between
#: two demonstrations they differ by centimetres, because the door stands elsewhere.
_SAME_DOOR_M = 0.03
#: The fastest recorded joint moves 0.2 rad in a control step of 10 ms.
_SAME_POSE_RAD = 0.3


class Hdf5Source:
    """Episodes of an HDF5 file; its layout is recognised by what is inside.

    Args:
        path: the ``.h5`` or ``.hdf5`` file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name

    def load(self) -> list[Episode]:
        """Read and check all episodes.

        Raises:
            DemonstrationError: the file is missing, corrupt, of no known layout, or holds no valid
                episodes of the door task.
        """
        with open_hdf5(self.path) as file:
            reader = next((layout.read for layout in _KNOWN if layout.fits(file)), None)
            if reader is None:
                found = ", ".join(sorted(file)) or "nothing"
                raise DemonstrationError(self.path, f"holds {found}", _LAYOUTS)
            return reader(file, self)


@dataclass(frozen=True)
class _Layout:
    fits: Callable[[h5py.File], bool]
    read: Callable[[h5py.File, Hdf5Source], list[Episode]]


def _read_own(_: h5py.File, source: Hdf5Source) -> list[Episode]:
    return read_recording(source.path)


def _read_trials(file: h5py.File, source: Hdf5Source) -> list[Episode]:
    # Trial10 comes after Trial9: names are sorted by number.
    names = sorted(filter(_TRIAL.match, file), key=lambda name: int(name.removeprefix("Trial")))
    return [_read_trial(file[name], i, source) for i, name in enumerate(names)]


def _read_trial(group: h5py.Group, index: int, source: Hdf5Source) -> Episode:
    where = f"{source.path}, {group.name}"
    require_keys(group, ("observations", "actions"), where, _LAYOUTS)

    def first(key: str) -> NDArray[np.generic] | None:
        path = f"env_infos/state/{key}"
        return read_array(group, path, where)[0] if path in group else None

    raw = RawEpisode(
        observations=read_array(group, "observations", where),
        actions=read_array(group, "actions", where),
        rewards=read_array(group, "rewards", where) if "rewards" in group else None,
        door_position=first("door_body_pos"),
        qpos=first("qpos"),
        qvel=first("qvel"),
    )
    return build_episode(raw, Provenance(source.name, index, "recorded"), where)


def _read_flat(file: h5py.File, source: Hdf5Source) -> list[Episode]:
    where = str(source.path)
    require_keys(file, ("observations", "actions", "rewards", "terminals"), where, _LAYOUTS)
    keys = ("observations", "actions", "rewards", "terminals", "timeouts")
    arrays = {key: read_array(file, key, where) for key in keys if key in file}
    if len({len(array) for array in arrays.values()}) != 1:
        sizes = ", ".join(f"{key} {len(array)}" for key, array in arrays.items())
        raise DemonstrationError(where, f"has arrays of different lengths ({sizes})", _LAYOUTS)
    states = {
        key: read_array(file, f"infos/{key}", where)
        for key in ("door_body_pos", "qpos", "qvel")
        if f"infos/{key}" in file
    }
    ends = arrays["terminals"].astype(bool) | arrays.get("timeouts", arrays["terminals"]).astype(
        bool
    )
    episodes = []
    for index, (start, stop, pieces) in enumerate(_rejoined(arrays["observations"], ends)):
        rows = slice(start, stop)
        raw = RawEpisode(
            observations=arrays["observations"][rows],
            actions=arrays["actions"][rows],
            rewards=arrays["rewards"][rows],
            door_position=_row(states, "door_body_pos", start),
            qpos=_row(states, "qpos", start),
            qvel=_row(states, "qvel", start),
        )
        provenance = Provenance(source.name, index, "recorded", {"pieces": pieces})
        episodes.append(build_episode(raw, provenance, f"{where}, rows {start}:{stop}"))
    return episodes


def _row(states: dict[str, NDArray[np.generic]], key: str, row: int) -> NDArray[np.generic] | None:
    return states[key][row] if key in states else None


def _rejoined(
    observations: NDArray[np.generic], ends: NDArray[np.bool_]
) -> Iterator[tuple[int, int, int]]:
    """Yield (first row, end row, number of pieces) of each whole demonstration.

    D4RL's door-human-v0 cuts every demonstration at 200 steps and continues it as the next
    "episode" (D4RL issue 137): alone, the first piece never opens the door and the second starts
    with the hand at the handle.
    """
    stops = [*(np.flatnonzero(ends) + 1), len(ends)]
    start, pieces = 0, 1
    for stop, following in zip(stops, [*stops[1:], stops[-1]], strict=True):
        if stop <= start:
            continue
        if stop < following and _continues(observations[stop - 1], observations[stop]):
            pieces += 1
            continue
        # A single row has no transition; it is what is left behind a cut at the very end.
        if stop - start > 1:
            yield start, int(stop), pieces
        start, pieces = int(stop), 1


def _continues(before: NDArray[np.generic], after: NDArray[np.generic]) -> bool:
    change = np.abs(np.asarray(after, dtype=np.float64) - np.asarray(before, dtype=np.float64))
    return bool(
        change[task.HANDLE].max() < _SAME_DOOR_M and change[task.HAND_QPOS].max() < _SAME_POSE_RAD
    )


_KNOWN = (
    _Layout(lambda file: file.attrs.get("format") == FORMAT, _read_own),
    _Layout(lambda file: any(map(_TRIAL.match, file)), _read_trials),
    _Layout(lambda file: "observations" in file and "actions" in file, _read_flat),
)
