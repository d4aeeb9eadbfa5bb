"""Where demonstrations begin, against where evaluations do; and actions at their bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from envs.demonstrations import saturated_share
from envs.demonstrations.coverage import least_covered, start_coverage
from tests.envs.demonstrations.files_of_others import toy_episode


def test_shares_by_hand():
    # x: 0, 1, 2, 3 against 0.5..2.5 covers 1 and 2; y: 0, 10, 20, 30 against 0..20 covers three;
    # both hold for the second and third start only. The last entry never varies.
    starts = {"seat": np.array([[0, 0, 7], [1, 10, 7], [2, 20, 7], [3, 30, 7]])}
    demos = {"seat": np.array([[0.5, 20, 0], [2.5, 0, 0]])}
    coverage = start_coverage(starts, demos)
    assert [(e.name, e.share) for e in coverage.entries] == [("seat[0]", 0.5), ("seat[1]", 0.75)]
    first = coverage.entries[0]
    assert (first.low, first.high, first.demo_low, first.demo_high) == (0, 3, 0.5, 2.5)
    assert coverage.share == 0.5
    assert [e.name for e in least_covered(coverage, 1)] == ["seat[0]"]


def test_starts_that_miss_each_other_in_turn():
    # Each entry covers half of the starts, but never of the same start.
    coverage = start_coverage({"a": np.array([[0, 1], [1, 0]])}, {"a": np.array([[0, 0]])})
    assert [e.share for e in coverage.entries] == [0.5, 0.5]
    assert coverage.share == 0.0


def test_saturation_counts_entries_within_a_hundredth_of_the_bounds():
    actions = np.float32([[0.995, 0.0], [-1.3, 0.98], [0.5, -0.991]])
    # 0.995, -1.3 and -0.991, of six.
    assert saturated_share([toy_episode(0, steps=3, actions=actions)]) == pytest.approx(0.5)
    assert math.isnan(saturated_share([]))
