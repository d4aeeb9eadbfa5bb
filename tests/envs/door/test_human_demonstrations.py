"""The 25 published demonstrations, on machines that have them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from envs.demonstrations import MultiplyConfig, multiply
from envs.door import task
from envs.door.variation import VARY
from tests.envs.demonstrations.helpers import load_door

FILE = Path(__file__).parents[4] / "shared" / "demos" / "dapg" / "door-v0_demos.pickle"
PUBLISHED = "d6ec9a090261f901e5c9bf10082799e30c8d34c3f28aef4026e492a1aefc96c3"
pytestmark = pytest.mark.skipif(
    not FILE.is_file(), reason="the DAPG demonstrations are not beside this repository"
)


@pytest.fixture(scope="module")
def human():
    assert hashlib.sha256(FILE.read_bytes()).hexdigest() == PUBLISHED
    return load_door(FILE)


def test_physics_and_reward_agree_with_the_file(human) -> None:
    assert len(human.episodes) == 25
    assert human.transitions == 6729 - 25
    assert sum(e.max_progress > task.SUCCESS_ANGLE for e in human.episodes) == 8
    assert min(e.max_progress for e in human.episodes) > 1.0
    assert max(r.replay_error_median for r in human.reports) < 0.06
    assert min(r.reward_agreement for r in human.reports) > 0.99
    share = sum(r.clipped_entries for r in human.reports) / (28 * human.transitions)
    assert share == pytest.approx(0.056, abs=0.002)


def test_multiplied_episodes_open_the_door_and_are_faster(human) -> None:
    openers = [e for e in human.episodes if e.max_progress > task.SUCCESS_ANGLE]
    kept = multiply(
        openers, MultiplyConfig(target_episodes=6, round_size=24, max_attempts=48), VARY
    )
    assert len(kept) == 6
    for episode in kept:
        assert episode.max_progress > task.SUCCESS_ANGLE
        assert episode.length == task.HORIZON
    original = np.mean([e.return_at(task.HORIZON) for e in openers])
    assert np.mean([e.return_ for e in kept]) > original
