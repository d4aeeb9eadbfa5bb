"""Actions in units of their own and in [-1, 1], by numbers worked out by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from envs.scaling import from_unit, to_unit

LOW, HIGH = np.array([-2.0, 0.0]), np.array([2.0, 10.0])


def test_by_hand():
    """A quarter of the way from 0 to 10 is 2.5, which is half of the way from -1 to 0."""
    assert from_unit([[-1.0, -0.5], [1.5, 1.0]], LOW, HIGH).tolist() == [[-2.0, 2.5], [3.0, 10.0]]
    assert to_unit([[-2.0, 2.5], [3.0, 10.0]], LOW, HIGH).tolist() == [[-1.0, -0.5], [1.5, 1.0]]


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(-1.1, 1.1))
def test_bounds_are_met_exactly_and_all_between_comes_back(low, width, unit):
    high = low + width
    assert from_unit([-1.0, 1.0], low, high).tolist() == [low, high]
    there = from_unit(unit, low, high)
    assert abs(to_unit(there, low, high) - unit) <= 1e-15 * (abs(low) + abs(high)) / width * 10
