"""Damaged copies of every format: whatever is wrong with a file is told as a DemonstrationError."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, DemoSchema, open_source, write_recording
from tests.envs.demonstrations.files_of_others import (
    ROBOMIMIC_SCHEMA,
    SCHEMA,
    following,
    toy_episode,
    write_dapg,
    write_flat,
    write_lerobot,
    write_minari,
    write_npz,
    write_robomimic,
    write_roboset,
)

EPISODES = [toy_episode(0), toy_episode(1, steps=4)]
# What is read in a process of its own costs a third of a second: fewer of these.
COUNTS = {"npz": 70, "lerobot": 30}
COUNT = 8


def write_minari_folder(path: Path) -> Path:
    import gymnasium

    space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
    write_minari("toy/whole-v0", EPISODES, [e.observations for e in EPISODES], space)
    return path.parent / "toy" / "whole-v0"


WRITERS: dict[str, Callable[[Path], Path | None]] = {
    "recording": lambda path: write_recording(path.with_suffix(".h5"), EPISODES, {}),
    "d4rl": lambda path: write_flat(
        path.with_suffix(".hdf5"), EPISODES, next_observations=following(EPISODES)
    ),
    "roboset": lambda path: write_roboset(path.with_suffix(".h5"), EPISODES),
    "robomimic": lambda path: write_robomimic(path.with_suffix(".hdf5"), EPISODES),
    "npz": lambda path: write_npz(path.with_suffix(".npz"), EPISODES),
    "dapg": lambda path: write_dapg(path.with_suffix(".pickle"), EPISODES),
    "lerobot": lambda path: write_lerobot(path, [EPISODES]),
    "minari": write_minari_folder,
}
NEEDS = {"lerobot": "pyarrow", "minari": "minari"}


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes changed, or the end cut off, or a stretch doubled."""
    array = np.frombuffer(content, dtype=np.uint8).copy()
    kind = rng.integers(4)
    if kind == 0:
        return content[: rng.integers(len(content))]
    if kind == 1:
        start, stop = sorted(rng.integers(len(content), size=2))
        return content[:stop] + content[start:]
    places = rng.integers(len(array), size=2 ** int(rng.integers(7)))
    if kind == 2:  # headers are where the harm is
        places = rng.integers(min(len(array), 2048), size=2 ** int(rng.integers(4)))
    array[places] = rng.integers(256, size=len(places))
    return array.tobytes()


def problem_of(path: Path, schema: DemoSchema) -> str | None:
    try:
        open_source(path).load(schema)
    except DemonstrationError as error:
        return str(error)
    return None


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WRITERS)
def test_damage_is_told_in_one_line(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    written = WRITERS[name](tmp_path / "whole")
    whole = written if written is not None else tmp_path / "whole.h5"
    schema = ROBOMIMIC_SCHEMA if name == "robomimic" else SCHEMA
    assert len(open_source(whole).load(schema)) == 2
    rng = np.random.default_rng(list(name.encode()))
    told = 0
    for i in range(COUNTS.get(name, COUNT)):
        copy = tmp_path / f"copy{i}{whole.suffix}"
        (shutil.copytree if whole.is_dir() else shutil.copy)(whole, copy)
        files = sorted(f for f in copy.rglob("*") if f.is_file()) if copy.is_dir() else [copy]
        file = files[rng.integers(len(files))]
        file.write_bytes(damaged(file.read_bytes(), rng))
        problem = problem_of(copy, schema)
        assert problem is None or "\n" not in problem
        told += problem is not None
    # Some damage hits numbers only, which nobody can see; most of it must be seen.
    assert told >= 4
