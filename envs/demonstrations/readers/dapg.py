"""The published DAPG pickle (Rajeswaran et al., 2018), read without running what is inside it.

The file is a list of dicts with ``observations`` [T, O], ``actions`` [T, A], ``rewards`` [T] and
``init_state_dict``, the simulator's state before the first action.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from envs.demonstrations import limits, unpickling_worker
from envs.demonstrations.children import run_child
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import first_bytes, one_line, read_npz, require_regular
from envs.demonstrations.findings import Notes
from envs.demonstrations.reading import FileSource, Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode, found_start, require_keys
from envs.one_line import text_of

_EXPECTED = "Expected the DAPG format: a list of dicts with observations, actions and rewards"
_SUFFIXES = (".pickle", ".pkl")
_STATE = "init_state_dict"


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Episodes in the order of the list."""
    for index, entry in enumerate(_episodes(_unpickled(path))):
        where = f"{path}, episode {index}"
        require_keys(entry, ("observations", "actions"), where, _EXPECTED)
        state = entry.get(_STATE)
        raw = RawEpisode(
            observations=entry["observations"],
            actions=entry["actions"],
            rewards=entry.get("rewards"),
            start=found_start(state if isinstance(state, Mapping) else {}, schema),
        )
        yield Record(raw, where)


class DapgSource(FileSource):
    """Episodes of a DAPG demonstration pickle.

    Args:
        path: the file.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(READER, Path(path))


def _episodes(arrays: dict[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """``{"3/init_state_dict/qpos": ...}`` as dicts of one episode each."""
    episodes: dict[int, dict[str, Any]] = {}
    for path, array in arrays.items():
        index, *keys = path.removeprefix("_").split("/")
        entry = episodes.setdefault(int(index), {})
        for key in keys[:-1]:
            inner = entry.setdefault(key, {})
            entry = inner if isinstance(inner, dict) else {}
        entry[keys[-1]] = array
    return [episodes[index] for index in sorted(episodes)]


def _unpickled(path: Path) -> dict[str, NDArray[Any]]:
    require_regular(path)
    with tempfile.TemporaryFile() as output:
        code = run_child(
            unpickling_worker.__file__, path, limits.MAX_DEPTH, limits.MAX_ELEMENTS, output=output
        )
        output.seek(0)
        if code == 0:
            return read_npz(output, str(path))
        raise _failure(path, code, output.read(limits.MAX_JSON_BYTES))


def _failure(path: Path, code: int, output: bytes) -> DemonstrationError:
    try:
        told = json.loads(output)
        problem = text_of(str(told["problem"]))
    except (ValueError, KeyError, TypeError) as error:
        told, problem = {}, f"the reading process ended with code {code}, {one_line(error)}"
    if told.get("whole"):
        return DemonstrationError(path, problem, _EXPECTED)
    if told.get("refused"):
        return DemonstrationError(
            path,
            f"would run code when opened: {problem}",
            "Only numpy arrays in plain containers are accepted; get the file from its publisher, "
            "or convert it to HDF5 if you trust it",
        )
    return DemonstrationError(
        path,
        f"is not a complete pickle ({problem})",
        "Download it again and compare its checksum",
    )


def _fits(path: Path) -> bool:
    if not path.is_file():
        return False
    if path.suffix.lower() in _SUFFIXES:
        return True
    start = first_bytes(path, 2)
    return len(start) == 2 and start[0] == 0x80 and 2 <= start[1] <= 5


READER = Reader(form="a DAPG pickle (.pickle, .pkl)", fits=_fits, read=read, suffixes=_SUFFIXES)
