"""D4RL's flat files and RoboSet's trials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, content_hash, open_source, write_recording
from envs.door.demos import SCHEMA
from tests.envs.demonstrations.helpers import DOOR, raw_demo, still_episode


def write_d4rl(path: Path, demos: list[dict[str, Any]], ends: list[int], infos: bool) -> Path:
    """One flat file; ``ends`` are the rows at which a timeout is set."""
    with h5py.File(path, "w") as file:
        for key in ("observations", "actions", "rewards"):
            file[key] = np.concatenate([demo[key] for demo in demos]).astype(np.float32)
        steps = len(file["rewards"])
        file["terminals"] = np.zeros(steps, dtype=bool)
        file["timeouts"] = np.isin(np.arange(steps), ends)
        if infos:
            doors = [demo["init_state_dict"]["door_body_pos"] for demo in demos]
            lengths = [len(demo["rewards"]) for demo in demos]
            file["infos/door_body_pos"] = np.repeat(doors, lengths, axis=0)
            file["infos/qpos"] = np.zeros((steps, 30))
            file["infos/qvel"] = np.zeros((steps, 30))
    return path


def two_doors() -> list[dict[str, Any]]:
    first, second = raw_demo(0, steps=12), raw_demo(1, steps=9)
    second["observations"][:, 32:35] += 0.05
    return [first, second]


@pytest.mark.parametrize("infos", [False, True])
def test_d4rl_episodes(tmp_path: Path, infos: bool) -> None:
    demos = two_doors()
    path = write_d4rl(tmp_path / "d.hdf5", demos, ends=[11, 20], infos=infos)
    episodes = open_source(path).load(SCHEMA)
    assert [e.length for e in episodes] == [11, 8]
    for episode, demo in zip(episodes, demos, strict=True):
        np.testing.assert_array_equal(
            episode.observations, np.float32(demo["observations"][:, :38])
        )
        np.testing.assert_array_equal(episode.actions, np.float32(demo["actions"][:-1]))
    if infos:
        np.testing.assert_allclose(episodes[1].start["door_position"], DOOR + 0.01)
    else:
        assert "door_position" not in episodes[1].start


def test_d4rl_demonstrations_cut_in_pieces_are_rejoined(tmp_path: Path) -> None:
    # As in door-human-v0: a timeout in the middle, after which the same demonstration continues.
    path = write_d4rl(tmp_path / "d.hdf5", two_doors(), ends=[7, 11, 17, 20], infos=True)
    episodes = open_source(path).load(SCHEMA)
    assert [e.length for e in episodes] == [11, 8]
    assert [e.provenance.details["pieces"] for e in episodes] == [2, 2]


def test_d4rl_same_door_but_another_pose_is_another_demonstration(tmp_path: Path) -> None:
    demos = [raw_demo(0, steps=12), raw_demo(0, steps=12)]
    demos[1]["observations"][:, :27] += 0.5
    path = write_d4rl(tmp_path / "d.hdf5", demos, ends=[11, 23], infos=False)
    assert [e.length for e in open_source(path).load(SCHEMA)] == [11, 11]


def test_d4rl_without_a_final_flag(tmp_path: Path) -> None:
    path = write_d4rl(tmp_path / "d.hdf5", two_doors(), ends=[11], infos=False)
    assert [e.length for e in open_source(path).load(SCHEMA)] == [11, 8]


def test_d4rl_arrays_of_different_lengths(tmp_path: Path) -> None:
    path = write_d4rl(tmp_path / "d.hdf5", two_doors(), ends=[11], infos=False)
    with h5py.File(path, "r+") as file:
        del file["rewards"]
        file["rewards"] = np.zeros(5)
    with pytest.raises(DemonstrationError, match=r"different lengths .*rewards 5"):
        open_source(path).load(SCHEMA)


@pytest.mark.parametrize("width", [3, 11, 17, 27])
def test_d4rl_observations_of_another_task_are_told_by_their_shape(tmp_path: Path, width: int):
    """Fewer columns than what the task would look at to join the pieces of an episode."""
    demos = [
        demo | {"observations": demo["observations"][:, :width]}
        for demo in (raw_demo(0), raw_demo(1))
    ]
    path = write_d4rl(tmp_path / "d.hdf5", demos, ends=[11, 23], infos=False)
    with pytest.raises(DemonstrationError) as refused:
        open_source(path).load(SCHEMA)
    assert str(path) in str(refused.value)
    assert f"{width}]" in str(refused.value)
    assert "39" in str(refused.value)


def test_d4rl_nan_names_the_rows(tmp_path: Path) -> None:
    demos = two_doors()
    demos[1]["observations"][2, 5] = np.nan
    path = write_d4rl(tmp_path / "d.hdf5", demos, ends=[11, 20], infos=False)
    with pytest.raises(DemonstrationError, match=r"rows 12:21: observations\[2, 5\] is nan"):
        open_source(path).load(SCHEMA)


def write_roboset(path: Path, demos: list[dict[str, Any]]) -> Path:
    with h5py.File(path, "w") as file:
        for i, demo in enumerate(demos):
            trial = file.create_group(f"Trial{i}")
            for key in ("observations", "actions", "rewards"):
                trial[key] = demo[key]
            trial["done"] = np.zeros(len(demo["rewards"]), dtype=bool)
            steps, state = len(demo["rewards"]), demo["init_state_dict"]
            trial["env_infos/state/qpos"] = np.tile(state["qpos"], (steps, 1))
            trial["env_infos/state/door_body_pos"] = np.tile(state["door_body_pos"], (steps, 1))
    return path


def test_roboset_trials_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    demos = [raw_demo(i, steps=4 + i, observation_size=38) for i in range(12)]
    episodes = open_source(write_roboset(tmp_path / "r.h5", demos)).load(SCHEMA)
    assert [e.length for e in episodes] == [3 + i for i in range(12)]
    np.testing.assert_array_equal(episodes[11].actions, np.float32(demos[11]["actions"][:-1]))
    np.testing.assert_allclose(episodes[11].start["door_position"], DOOR + 0.11)
    np.testing.assert_array_equal(episodes[11].start["qpos"], np.zeros(30))
    assert "qvel" not in episodes[11].start


def test_roboset_trial_of_another_task(tmp_path: Path) -> None:
    demo = raw_demo(observation_size=45)
    path = write_roboset(tmp_path / "r.h5", [demo])
    with pytest.raises(DemonstrationError, match=r"Trial0: observations has shape \[12, 45\]"):
        open_source(path).load(SCHEMA)


def test_own_recordings_are_recognised(tmp_path: Path) -> None:
    written = [still_episode()]
    write_recording(tmp_path / "r.h5", written, {})
    assert content_hash(open_source(tmp_path / "r.h5").load(SCHEMA)) == content_hash(written)


def test_unknown_layout(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["pictures"] = np.zeros(3)
    with pytest.raises(DemonstrationError, match="holds pictures") as caught:
        open_source(tmp_path / "r.h5").load(SCHEMA)
    assert "Trial" in str(caught.value)


def test_not_hdf5(tmp_path: Path) -> None:
    (tmp_path / "r.hdf5").write_bytes(b"plain text")
    with pytest.raises(DemonstrationError, match="not a readable HDF5 file"):
        open_source(tmp_path / "r.hdf5").load(SCHEMA)


def test_a_group_where_data_should_be(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file.create_group("Trial0/observations")
        file["Trial0/actions"] = np.zeros((3, 28))
    with pytest.raises(DemonstrationError, match=r"Trial0: lacks the observation"):
        open_source(tmp_path / "r.h5").load(SCHEMA)
