"""The arm's guide."""

from __future__ import annotations

import numpy as np
import pytest

from envs.adroit.simulator import HandSimulator
from envs.door import hand, task
from envs.door.resimulation import RESIMULATE
from envs.door.variation import GUIDE
from tests.envs.demonstrations.helpers import DOOR, still_episode


@pytest.mark.parametrize("offset", [[0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04], [-0.03, 0.02, -0.03]])
def test_the_palm_moves_with_the_door(offset: list[float]) -> None:
    steps = 120
    still = still_episode(steps=steps, actions=np.zeros((steps, 28), dtype=np.float32))
    (recorded,) = RESIMULATE([still])
    ramp = np.minimum(np.arange(steps) / 40, 1.0)
    gain = GUIDE.action_per_metre(hand.build_scene(), recorded.observations[:-1], ramp)
    assert gain.shape == (steps, 4, 3)
    np.testing.assert_array_equal(gain[0], np.zeros((4, 3)))
    guided = recorded.actions.astype(np.float64)
    guided[:, GUIDE.arm] += gain @ np.array(offset)
    # The palm may not touch the door here, so it stays where it was recorded.
    with HandSimulator(hand.DOOR, 1) as simulator:
        simulator.start({hand.DOOR_POSITION: DOOR[None]})
        for action in guided:
            observation = simulator.step(action[None])[0]
    moved = observation[task.PALM] - recorded.observations[-1, task.PALM]
    np.testing.assert_allclose(moved, offset, atol=0.008)
