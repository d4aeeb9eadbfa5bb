"""Replay: which doors go on, and what happens when physics breaks down."""

from __future__ import annotations

import numpy as np
import pytest

from envs.adroit.replay import Replay
from envs.adroit.replay import replay as play
from envs.adroit.simulator import HandSimulator, PhysicsDivergedError
from envs.demonstrations import DemonstrationError
from envs.door import hand
from envs.door.hand import DOOR_POSITION
from envs.door.resimulation import RESIMULATE
from tests.envs.demonstrations.helpers import DOOR, still_episode


class Breaking(HandSimulator):
    """A simulator whose door 1 diverges in its third step, and which refuses to step it again."""

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self.calls = 0

    def step(self, action, mask=None):
        self.calls += 1
        observation = super().step(action, mask)
        if mask[1] and self.calls >= 3:
            assert self.calls == 3, "a broken door must not be stepped"
            raise PhysicsDivergedError([1])
        return observation


def test_a_diverged_door_stops_and_the_others_go_on() -> None:
    actions, doors = np.zeros((3, 6, 28)), np.tile(DOOR, (3, 1))
    with Breaking(hand.DOOR, 3, num_threads=1) as simulator:
        result = play(simulator, actions, np.array([6, 6, 4]), {DOOR_POSITION: doors})
    assert result.steps.tolist() == [6, 2, 4]
    assert result.diverged.tolist() == [False, True, False]
    with HandSimulator(hand.DOOR, 1) as simulator:
        alone = play(simulator, actions[:1], np.array([6]), {DOOR_POSITION: doors[:1]})
    np.testing.assert_array_equal(result.observations[0], alone.observations[0])


def test_an_episode_that_diverges_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envs.adroit.resimulation.HandSimulator", Breaking)
    with pytest.raises(DemonstrationError, match="synthetic, episode 1: makes the physics diverge"):
        RESIMULATE([still_episode(0), still_episode(1)])


def test_a_door_may_be_abandoned() -> None:
    def keep_going(steps: int, played: Replay) -> np.ndarray:
        assert played.steps.tolist() == [min(steps, 3), steps]
        return np.array([steps < 3, True])

    with HandSimulator(hand.DOOR, 2, num_threads=1) as simulator:
        doors = {DOOR_POSITION: np.tile(DOOR, (2, 1))}
        lengths = np.array([5, 5])
        result = play(simulator, np.zeros((2, 5, 28)), lengths, doors, keep_going=keep_going)
    assert result.steps.tolist() == [3, 5]
    assert not result.observations[0, 4:].any()


def test_only_what_was_played_after_the_start_counts() -> None:
    """Three copies of at most three steps, of which 1, 3 and 2 were played."""
    played = Replay.empty(3, 3, 38)
    played.steps[:] = [1, 3, 2]
    holds = np.array([[0, 0, 1, 1], [1, 0, 0, 0], [0, 0, 1, 0]], dtype=bool)
    # Of the first it holds where nothing was played, of the second only before its first step.
    assert played.ever(holds).tolist() == [False, False, True]
