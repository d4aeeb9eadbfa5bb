"""Simulator steps beside training: every open count sees them, whoever takes them says so."""

from __future__ import annotations

import numpy as np
import pytest

from envs.adroit.simulator import HandSimulator
from envs.demonstrations import MultiplyConfig
from envs.demonstrations.multiplication import multiply
from envs.demonstrations.multiplication_cache import multiply_cached
from envs.door.resimulation import RESIMULATE
from envs.door.variation import VARY
from envs.steps import count_steps, counted_steps
from tests.envs.demonstrations.helpers import still_episode

CONFIG = MultiplyConfig(target_episodes=4, round_size=4, min_progress=-1.0, horizon=6)


def test_counts_within_one_another_see_the_same_steps():
    with counted_steps() as outer:
        count_steps(2)
        with counted_steps() as inner:
            count_steps(3)
        count_steps(4)
    count_steps(100)
    assert (outer.taken, inner.taken) == (9, 3)


def test_a_count_ends_with_an_error_inside_it():
    with counted_steps() as outer:
        with pytest.raises(RuntimeError), counted_steps() as inner:
            raise RuntimeError
        count_steps(1)
    assert (outer.taken, inner.taken) == (1, 0)


def test_negative_steps_are_refused():
    with pytest.raises(ValueError, match="got -1"):
        count_steps(-1)


@pytest.fixture
def advanced(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Copies that the simulator advanced, call by call."""
    seen: list[int] = []
    step = HandSimulator.step

    def watched(self, action, mask=None):
        seen.append(self.num_copies if mask is None else int(np.sum(mask)))
        return step(self, action, mask)

    monkeypatch.setattr(HandSimulator, "step", watched)
    return seen


def test_what_is_counted_is_what_the_simulator_did(advanced: list[int], tmp_path):
    with counted_steps() as replayed:
        sources = RESIMULATE([still_episode(i, steps=5 + i) for i in range(2)], num_threads=1)
    assert replayed.taken == sum(advanced) > 0
    advanced.clear()
    with counted_steps() as multiplied:
        multiply(sources, CONFIG, VARY, num_threads=1)
    assert multiplied.taken == sum(advanced) >= 4 * 6


def test_what_a_cache_holds_counts_as_when_it_was_made(advanced: list[int], tmp_path):
    sources = RESIMULATE([still_episode(0, steps=5)], num_threads=1)
    taken = []
    for _ in range(2):
        with counted_steps() as steps:
            multiply_cached(sources, CONFIG, VARY, cache_dir=tmp_path)
        taken.append(steps.taken)
        before = len(advanced)
    assert taken[0] == taken[1] > 0
    with counted_steps():
        multiply_cached(sources, CONFIG, VARY, cache_dir=tmp_path)
    assert len(advanced) == before, "the cache was not used"
