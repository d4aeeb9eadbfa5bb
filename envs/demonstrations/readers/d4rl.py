"""D4RL's HDF5 files: all episodes in flat arrays, one row per action."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import open_hdf5, read_array
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.flattening import flatten_columns, named_columns
from envs.demonstrations.readers.hdf5_layout import peek, read_observations, read_states
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

_SUCCESS = ("infos/success", "infos/is_success")
_PROGRESS, _FIRST_SUCCESS, _FIRST_PROGRESS = (
    "infos/progress", "infos/success_at_start", "infos/progress_at_start",
)  # fmt: skip


@dataclass(frozen=True)
class _Rows:
    """The arrays of one file, [N, ...] each."""

    observations: Mapping[str, NDArray[Any]]
    following: Mapping[str, NDArray[Any]] | None
    columns: Mapping[str, NDArray[Any]]
    states: Mapping[str, NDArray[Any]]

    @property
    def count(self) -> int:
        return len(self.columns["actions"])

    def flag(self, key: str) -> NDArray[np.bool_]:
        return self.columns.get(key, np.zeros(self.count)).astype(bool)


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Episodes between the rows that ``terminals``, ``timeouts`` or ``next_observations`` end.

    D4RL's human demonstrations are cut at the time limit and go on as the next "episode" (D4RL
    issue 137): alone, the first piece never succeeds and the second starts in the middle. The
    task's schema tells which rows continue one another.

    Raises:
        DemonstrationError: nothing in the file tells where its episodes end, or its arrays differ
            in length.
    """
    with open_hdf5(path) as file:
        rows = _rows(file, str(path), schema)
    ends = _ends(rows, str(path), notes)
    for start, stop, pieces in _episodes(rows, ends, path, schema, notes):
        taken = slice(start, stop)
        raw = RawEpisode(
            observations=_unnamed(_observed(rows, taken)),
            actions=rows.columns["actions"][taken],
            rewards=rows.columns["rewards"][taken] if "rewards" in rows.columns else None,
            terminated=rows.flag("terminals")[taken],
            start={key: values[start] for key, values in rows.states.items()},
            **_outcome(rows.columns, taken),
        )
        yield Record(raw, f"{path}, rows {start}:{stop}", {"pieces": pieces})


def _rows(file: h5py.File, where: str, schema: DemoSchema) -> _Rows:
    keys = (
        "actions", "rewards", "terminals", "timeouts",
        *_SUCCESS, _PROGRESS, _FIRST_SUCCESS, _FIRST_PROGRESS,
    )  # fmt: skip
    columns = {key: read_array(file, key, where) for key in keys if key in file}
    if not columns["actions"].ndim:
        raise DemonstrationError(where, "actions has shape []", "Expected one row per action")
    rows = _Rows(
        observations=_named(file, "observations", where),
        following=_named(file, "next_observations", where) if "next_observations" in file else None,
        columns=columns,
        states=read_states(file, "infos", where, schema),
    )
    sized = {**rows.observations, **columns, **rows.states}
    sized |= {f"next_observations {key}": a for key, a in (rows.following or {}).items()}
    lengths = {key: len(array) if array.ndim else 0 for key, array in sized.items()}
    if len(set(lengths.values())) != 1:
        sizes = ", ".join(f"{key or 'observations'} {size}" for key, size in lengths.items())
        raise DemonstrationError(
            where,
            f"has arrays of different lengths ({sizes})",
            "Expected one row per action in each",
        )
    return rows


def _named(file: h5py.File, key: str, where: str) -> dict[str, NDArray[Any]]:
    found = read_observations(file, key, where)
    return named_columns(found if isinstance(found, dict) else {"": found}, where)


def _ends(rows: _Rows, where: str, notes: Notes) -> NDArray[np.bool_]:
    """Bool [N], the last row of each episode."""
    flags = rows.flag("terminals") | rows.flag("timeouts")
    if rows.following is not None:
        return flags | _breaks(rows, flags, where, notes)
    if not flags.any():
        raise DemonstrationError(
            where,
            f"does not say where its episodes end: no row of terminals or timeouts is set in "
            f"{rows.count:,}, and there are no next_observations",
            "Store `timeouts` (1 at the last row of each episode) or `next_observations`",
        )
    if "timeouts" not in rows.columns:
        notes.add(Kind.NO_TIMEOUTS, 1, where)
    return flags


def _breaks(rows: _Rows, flags: NDArray[np.bool_], where: str, notes: Notes) -> NDArray[np.bool_]:
    """Rows whose next observation is not the next row's observation."""
    breaks = np.zeros(rows.count, dtype=bool)
    for key, after in (rows.following or {}).items():
        if key not in rows.observations or rows.observations[key].shape != after.shape:
            raise DemonstrationError(
                where, "observations and next_observations differ in shape", "Repair the file"
            )
        differ = after[:-1] != rows.observations[key][1:]
        breaks[:-1] |= differ.reshape(len(differ), -1).any(axis=1)
    breaks &= ~flags
    if breaks.sum() > rows.count / 2:
        raise DemonstrationError(
            where,
            f"has next_observations that are not the next row's observations in "
            f"{breaks.sum():,} of {rows.count:,} rows",
            "Store rows in the order of time, with `timeouts` and no next_observations",
        )
    if breaks.any():
        notes.add(Kind.ENDS_FOUND, int(breaks.sum()), f"{where}, row {int(breaks.argmax())}")
    return breaks


def _episodes(
    rows: _Rows, ends: NDArray[np.bool_], path: Path, schema: DemoSchema, notes: Notes
) -> Iterator[tuple[int, int, int]]:
    """Yield (first row, end row, number of pieces) of each whole demonstration."""
    stops = [*(np.flatnonzero(ends) + 1), rows.count]
    start, pieces = 0, 1
    shortest = 1 if rows.following is not None else 2  # rows with a transition
    for stop in map(int, stops):
        if stop <= start:
            continue
        if stop < rows.count and _goes_on(rows, stop, schema):
            notes.add(Kind.JOINED, 1, f"{path}, row {stop - 1}")
            pieces += 1
            continue
        if stop - start >= shortest:
            yield start, stop, pieces
        else:
            notes.add(Kind.SHORT, 1, f"{path}, row {start}")
        start, pieces = stop, 1


def _goes_on(rows: _Rows, stop: int, schema: DemoSchema) -> bool:
    """Whether the row ``stop`` belongs to the demonstration of the row before."""
    if schema.continues is None or rows.flag("terminals")[stop - 1]:
        return False
    before = rows.observations if rows.following is None else rows.following
    pair = {
        key: np.concatenate([before[key][stop - 1 : stop], values[stop : stop + 1]])
        for key, values in rows.observations.items()
    }
    before_it, after = flatten_columns(pair, where=f"row {stop}")
    if len(after) not in schema.widths:  # of another task, which the gate says in its own words
        return False
    return bool(schema.continues(before_it, after))


def _observed(rows: _Rows, taken: slice) -> dict[str, NDArray[Any]]:
    if rows.following is None:
        return {key: values[taken] for key, values in rows.observations.items()}
    last = slice(taken.stop - 1, taken.stop)
    return {
        key: np.concatenate([values[taken], rows.following[key][last]])
        for key, values in rows.observations.items()
    }


def _unnamed(columns: dict[str, NDArray[Any]]) -> Any:
    return columns[""] if set(columns) == {""} else columns


def _outcome(columns: Mapping[str, NDArray[Any]], taken: slice) -> dict[str, Any]:
    """``success`` and ``progress``, with their values at the start where those are known."""
    found: dict[str, Any] = {}
    key = next((name for name in _SUCCESS if name in columns), None)
    if key is not None:
        start = [columns[_FIRST_SUCCESS][taken][:1]] if _FIRST_SUCCESS in columns else []
        found["success"] = np.concatenate([*start, columns[key][taken]])
    if _PROGRESS in columns and _FIRST_PROGRESS in columns:
        first = columns[_FIRST_PROGRESS][taken][:1]
        found["progress"] = np.concatenate([first, columns[_PROGRESS][taken]])
    return found


READER = Reader(
    form="D4RL HDF5 (observations, actions, rewards, terminals, timeouts)",
    fits=lambda path: peek(path, lambda file: {"observations", "actions"} <= set(file)),
    read=read,
)
