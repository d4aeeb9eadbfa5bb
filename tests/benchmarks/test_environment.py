"""That the doors whose steps are timed are those of whole episodes."""

from __future__ import annotations

import pytest

from benchmarks.environment import Doors
from envs.door.task import HORIZON


@pytest.mark.parametrize("count", [20, 100])
def test_doors_stand_in_all_phases_of_an_episode(count: int):
    doors = Doors(count, threads=1)
    elapsed = doors.env.elapsed_steps.double()
    assert elapsed.mean() == pytest.approx((HORIZON - 1) / 2, abs=2)
    assert elapsed.std() == pytest.approx(HORIZON / 12**0.5, rel=0.1)
    before = doors.env.simulator.qpos
    doors.call()
    assert (doors.env.simulator.qpos != before).any(axis=1).all()
    doors.env.close()
