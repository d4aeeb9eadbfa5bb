"""NumPy's npz files: one episode, or several stacked with ``episode_ends``.

``observations`` [T, O] or [T + 1, O] (or ``observations/KEY`` for each of several arrays),
``actions`` [T, A] and, where known, ``rewards`` [T], ``terminated`` [T], ``success`` [T] or
[T + 1], ``progress`` [T + 1] and ``start/NAME`` [size].

Stacked, ``episode_ends`` [E] counts the actions up to and with each episode, as in Diffusion Policy
(Chi et al., 2023); the arrays of all episodes follow one another, whether an episode has T rows or
T + 1; ``start/NAME`` is [E, size].
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import read_npz
from envs.demonstrations.findings import Notes
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode, found_start, require_keys

_OBSERVATIONS = "observations"
_ENDS = "episode_ends"
_START = "start/"
_SUFFIX = ".npz"
_OPTIONAL = ("rewards", "terminated", "success", "progress")
_REMEDY = "Expected observations [T + 1, O] and actions [T, A] (docs/reference/demonstrations.md)"


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """The file's episode, or its episodes in their order."""
    arrays = read_npz(path, str(path))
    require_keys(arrays, ("actions",), str(path), _REMEDY)
    if _ENDS not in arrays:
        yield Record(_raw(arrays, schema, str(path)), str(path))
        return
    for index, episode in enumerate(_split(arrays, str(path))):
        where = f"{path}, episode {index}"
        yield Record(_raw(episode, schema, where), where)


def _raw(arrays: Mapping[str, NDArray[Any]], schema: DemoSchema, where: str) -> RawEpisode:
    named = {
        key.removeprefix(f"{_OBSERVATIONS}/"): values
        for key, values in arrays.items()
        if key.startswith(f"{_OBSERVATIONS}/")
    }
    if not named:
        require_keys(arrays, (_OBSERVATIONS,), where, _REMEDY)
    start = {k.removeprefix(_START): v for k, v in arrays.items() if k.startswith(_START)}
    optional: dict[str, Any] = {key: arrays[key] for key in _OPTIONAL if key in arrays}
    return RawEpisode(
        observations=named or arrays[_OBSERVATIONS],
        actions=arrays["actions"],
        start=found_start(start, schema),
        **optional,
    )


def _split(arrays: dict[str, NDArray[Any]], where: str) -> Iterator[dict[str, NDArray[Any]]]:
    ends = arrays.pop(_ENDS)
    rows = {key: len(values) if values.ndim else 0 for key, values in arrays.items()}
    whole = ends.dtype.kind in "iu" and ends.ndim == 1 and len(ends) > 0
    if not whole or (np.diff(ends, prepend=0) < 1).any() or int(ends[-1]) != rows["actions"]:
        raise DemonstrationError(
            where,
            f"episode_ends {ends.ravel()[:5]}... does not rise to the {rows['actions']} actions",
            "It counts the actions up to and with each episode",
        )
    for key, found in rows.items():
        allowed = {rows["actions"], rows["actions"] + len(ends)}
        if found not in ({len(ends)} if key.startswith(_START) else allowed):
            raise DemonstrationError(
                where,
                f"{key} has {found} rows for {rows['actions']} actions in {len(ends)} episodes",
                _REMEDY,
            )
    for index, (first, stop) in enumerate(zip([0, *map(int, ends)], map(int, ends), strict=False)):
        yield {
            key: values[index]
            if key.startswith(_START)
            # With one row more per episode, those of all episodes before come in between.
            else values[first + index : stop + index + 1]
            if rows[key] != rows["actions"]
            else values[first:stop]
            for key, values in arrays.items()
        }


def _fits(path: Path) -> bool:
    if not path.is_file():
        return False
    if path.suffix.lower() == _SUFFIX:
        return True
    try:
        with zipfile.ZipFile(path) as archive:
            return "actions.npy" in archive.namelist()
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


READER = Reader(
    form="npz (observations, actions, rewards; episode_ends where several are stacked)",
    fits=_fits,
    read=read,
    suffixes=(_SUFFIX,),
)
