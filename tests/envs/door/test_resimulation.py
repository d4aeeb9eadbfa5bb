"""Re-simulation: what the simulator really does with the recorded actions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from envs.adroit.simulator import HandSimulator
from envs.demonstrations import DemonstrationError
from envs.demonstrations.report import replay_error
from envs.door import hand, task
from envs.door.resimulation import RESIMULATE
from tests.envs.demonstrations.helpers import DOOR, door_of, still_episode


@pytest.fixture(scope="module")
def played():
    return RESIMULATE([still_episode(i, steps=5 + i) for i in range(3)], num_threads=1)


def test_equals_stepping_the_simulator(played) -> None:
    recorded = still_episode(2, steps=7)
    with HandSimulator(hand.DOOR, 1) as simulator:
        expected = [simulator.start({hand.DOOR_POSITION: door_of(recorded)[None]})[0]]
        expected += [simulator.step(action[None])[0] for action in recorded.actions]
    episode = played[2]
    np.testing.assert_array_equal(episode.observations, np.stack(expected))
    np.testing.assert_array_equal(episode.rewards, task.reward(np.stack(expected[1:])))
    np.testing.assert_array_equal(episode.actions, recorded.actions)
    assert (episode.provenance.kind, episode.provenance.episode) == ("resimulated", 2)


def test_starts_in_the_reset_pose(played) -> None:
    for episode in played:
        assert not episode.observations[0, : task.PALM.start].any()


def test_a_recorded_pose_is_left_out() -> None:
    elsewhere = still_episode(0, qpos=np.full(30, 0.1), qvel=np.ones(30))
    (episode,) = RESIMULATE([elsewhere])
    assert episode.start.keys() == {hand.DOOR_POSITION}
    np.testing.assert_array_equal(
        episode.observations, RESIMULATE([still_episode(0)])[0].observations
    )


def test_resimulating_again_changes_nothing(played) -> None:
    again = RESIMULATE(played, num_threads=2)
    for first, second in zip(played, again, strict=True):
        np.testing.assert_array_equal(first.observations, second.observations)
        assert replay_error(first, second).maximum == 0.0


def test_a_partly_filled_last_batch(monkeypatch: pytest.MonkeyPatch, played) -> None:
    monkeypatch.setattr("envs.adroit.resimulation.BATCH", 2)
    batched = RESIMULATE([still_episode(i, steps=5 + i) for i in range(3)], num_threads=1)
    for one, other in zip(played, batched, strict=True):
        np.testing.assert_array_equal(one.observations, other.observations)


def test_unknown_door_position_is_inferred_from_the_handle(played) -> None:
    nameless = [dataclasses.replace(episode, start={}) for episode in played]
    for episode, again in zip(played, RESIMULATE(nameless), strict=True):
        np.testing.assert_allclose(door_of(again), door_of(episode), atol=1e-6)
        np.testing.assert_allclose(again.observations, episode.observations, atol=1e-4)


def test_unknown_position_of_an_open_door_is_an_error(played) -> None:
    observations = played[0].observations.copy()
    observations[0, task.HINGE] = 0.5
    opened = dataclasses.replace(played[0], start={}, observations=observations)
    with pytest.raises(DemonstrationError, match="no door position"):
        RESIMULATE([opened])


def test_replay_error_is_the_distance_over_common_steps() -> None:
    recorded, simulated = still_episode(0, steps=6), still_episode(0, steps=6)
    observations = simulated.observations.copy()
    observations[2, 3] += 0.5
    short = dataclasses.replace(
        simulated, observations=observations[:5], actions=simulated.actions[:4]
    )
    error = replay_error(recorded, short)
    assert error.median == 0.0
    assert error.maximum == pytest.approx(0.5)


def test_the_door_is_where_the_recording_says(played) -> None:
    for seed, episode in enumerate(played):
        offset = episode.observations[0, task.HANDLE] - (DOOR + 0.01 * seed)
        np.testing.assert_allclose(offset, [0.29, -0.15, -0.025], atol=1e-4)


def test_leaving_the_door_ends_the_episode() -> None:
    far = still_episode(0, door_position=np.array([-0.25, 1.5, 0.3]))
    (episode,) = RESIMULATE([far])
    assert episode.length == 1
    assert episode.terminated.tolist() == [True]


def test_nothing_in_nothing_out() -> None:
    assert RESIMULATE([]) == []
