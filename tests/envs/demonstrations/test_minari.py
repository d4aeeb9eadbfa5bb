"""Minari datasets, written by the minari library itself, offline."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, open_source
from envs.door.demos import SCHEMA
from tests.envs.demonstrations.helpers import DOOR, raw_demo

minari = pytest.importorskip("minari", reason="the minari extra is not installed")
gymnasium = pytest.importorskip("gymnasium")

ID = "tests/door/human-v0"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.setenv("MINARI_OFFLINE", "1")
    return tmp_path


def write_dataset(
    demos: list[dict[str, Any]], data_format: str = "hdf5", infos: bool = True, dataset: str = ID
) -> None:
    buffers = []
    for demo in demos:
        steps, state = len(demo["rewards"]) - 1, demo["init_state_dict"]
        last = np.arange(steps) == steps - 1
        buffers.append(
            minari.data_collector.EpisodeBuffer(
                observations=demo["observations"],
                actions=demo["actions"][:-1],
                rewards=demo["rewards"][:-1],
                terminations=np.zeros(steps, dtype=bool),
                truncations=last,
                infos={
                    "door_body_pos": np.tile(state["door_body_pos"], (steps + 1, 1)),
                    "qpos": np.tile(state["qpos"], (steps + 1, 1)),
                }
                if infos
                else None,
            )
        )
    width = demos[0]["observations"].shape[1]
    minari.create_dataset_from_buffers(
        dataset,
        buffer=buffers,
        observation_space=gymnasium.spaces.Box(-np.inf, np.inf, (width,), np.float64),
        action_space=gymnasium.spaces.Box(-2.0, 2.0, demos[0]["actions"].shape[1:], np.float64),
        author="tests",
        author_email="tests@example.org",
        code_permalink="none",
        algorithm_name="none",
        description="synthetic",
        data_format=data_format,
    )


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("by_folder", [False, True])
@pytest.mark.parametrize("infos", [False, True])
def test_episodes(root: Path, by_folder: bool, infos: bool) -> None:
    demos = [raw_demo(0), raw_demo(1, steps=7)]
    write_dataset(demos, infos=infos)
    spec = str(root / ID) if by_folder else f"minari:{ID}"
    first, second = open_source(spec).load(SCHEMA)
    assert (first.length, second.length) == (11, 6)
    np.testing.assert_array_equal(first.observations, np.float32(demos[0]["observations"][:, :38]))
    np.testing.assert_array_equal(second.actions, np.float32(demos[1]["actions"][:-1]))
    np.testing.assert_array_equal(second.rewards, np.float32(demos[1]["rewards"][:-1]))
    if infos:
        np.testing.assert_allclose(second.start["door_position"], DOOR + 0.01)
        np.testing.assert_array_equal(second.start["qpos"], np.zeros(30))
    else:
        assert "door_position" not in second.start
    assert second.provenance.episode == 1
    assert second.provenance.source == ("human-v0" if by_folder else f"minari:{ID}")


@pytest.mark.filterwarnings("ignore")
def test_nan_in_a_dataset(root: Path) -> None:
    demo = raw_demo()
    demo["observations"][3, 2] = np.nan
    write_dataset([demo])
    with pytest.raises(DemonstrationError, match=r"episode 0: observations\[3, 2\] is nan"):
        open_source(f"minari:{ID}").load(SCHEMA)


@pytest.mark.filterwarnings("ignore")
def test_dataset_of_another_task(root: Path) -> None:
    write_dataset([raw_demo(observation_size=45)])
    with pytest.raises(DemonstrationError, match=r"\[12, 45\], expected \[T, 38\] or \[T, 39\]"):
        open_source(f"minari:{ID}").load(SCHEMA)


@pytest.mark.filterwarnings("ignore")
def test_unknown_id(root: Path) -> None:
    with pytest.raises(DemonstrationError, match="minari download tests/door/absent-v0"):
        open_source("minari:tests/door/absent-v0").load(SCHEMA)


@pytest.mark.filterwarnings("ignore")
def test_damaged_data_file(root: Path) -> None:
    write_dataset([raw_demo()])
    data = root / ID / "data" / "main_data.hdf5"
    data.write_bytes(data.read_bytes()[:500])
    with pytest.raises(DemonstrationError, match="human-v0"):
        open_source(str(root / ID)).load(SCHEMA)


def test_without_minari_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(
        DemonstrationError, match=r"needs the package minari .*pip install '.*\[minari\]'"
    ):
        open_source("minari:D4RL/door/human-v2").load(SCHEMA)
