from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from envs.door import task
from tests.envs.door.conftest import PROPERTY


def observation(hinge: float = 0.0, palm_to_handle=(0.0, 0.0, 0.0), columns: int = 38):
    row = np.full(columns, 9.0, dtype=np.float32)
    row[28] = hinge
    row[35:38] = palm_to_handle
    return row


@pytest.mark.parametrize(
    ("hinge", "palm_to_handle", "expected"),
    [
        # hinge = 0: -0.1 * 1.57^2 = -0.24649
        (0.0, (0, 0, 0), -0.24649),
        # 3-4-12 box in dm: distance 1.3 m
        (0.0, (0.3, 0.4, 1.2), -0.24649 - 0.13),
        # not yet above the first threshold, which is exclusive: -0.1 * 1.32^2 = -0.174240
        (0.25, (0, 0, 0), -0.174240 + 2),
        (0.125, (0, 0, 0), -0.2088025),
        # -0.1 * 0.57^2 = -0.03249; 1.0 is not above 1.0
        (1.0, (0, 0, 0), -0.03249 + 2),
        (1.25, (0, 0, 0), -0.01024 + 2 + 8),
        # -0.1 * 0.07^2 = -0.00049
        (1.5, (0, 0, 0), -0.00049 + 2 + 8 + 10),
        (1.5, (0, 0.5, 0), -0.00049 + 20 - 0.05),
    ],
)
def test_reward_by_hand(hinge, palm_to_handle, expected):
    value = task.reward(observation(hinge, palm_to_handle))
    assert value.dtype == np.float32
    assert value == pytest.approx(expected, abs=1e-6)


def test_reward_falls_with_the_distance_to_the_handle():
    """gymnasium-robotics 1.2.1..1.4.2 has this sign wrong."""
    near, far = observation(palm_to_handle=(0.1, 0, 0)), observation(palm_to_handle=(0.2, 0, 0))
    assert task.reward(near) - task.reward(far) == pytest.approx(0.01, abs=1e-6)


@PROPERTY
@given(npst.arrays(np.float32, (3, 5, 39), elements=st.floats(-2, 2, width=32)))
def test_functions_keep_the_leading_shape_and_ignore_extra_columns(batch):
    for function in (task.reward, task.terminated, task.success, task.hinge_angle):
        whole = function(batch)
        assert whole.shape == (3, 5)
        np.testing.assert_array_equal(whole, function(batch[..., :38]))
        assert whole[1, 2] == function(batch[1, 2])


@PROPERTY
@given(st.floats(0, 1.57), st.floats(0, 1.57))
def test_opening_further_never_costs_reward(one, other):
    low, high = sorted((one, other))
    assert task.reward(observation(high)) >= task.reward(observation(low))


@pytest.mark.parametrize(("distance", "expected"), [(0.999, False), (1.0, False), (1.001, True)])
def test_terminated_when_the_hand_is_out_of_reach(distance, expected):
    # Along one axis, so that the distance is exact.
    assert task.terminated(observation(palm_to_handle=(0, -distance, 0))) == expected


@pytest.mark.parametrize(("hinge", "expected"), [(1.34, False), (1.36, True), (math.nan, False)])
def test_success(hinge, expected):
    assert task.success(observation(hinge)) == expected


@pytest.mark.parametrize(
    ("angles", "expected"),
    [([0.0, 0.1], 0), ([0.0, 0.3, 0.0], 1), ([1.1, 0.0], 2), ([0.1, 1.4, 1.2], 3)],
)
def test_stage_remembers_the_widest_angle(angles, expected):
    assert task.stage(np.stack([observation(angle) for angle in angles])) == expected


def test_slices_tile_the_observation():
    index = np.arange(task.OBSERVATION_SIZE)
    parts = [task.HAND_QPOS, task.LATCH, task.HINGE, task.PALM, task.HANDLE, task.PALM_TO_HANDLE]
    np.testing.assert_array_equal(np.concatenate([np.atleast_1d(index[p]) for p in parts]), index)


def test_short_observations_are_refused():
    with pytest.raises(ValueError, match=r"at least 38 entries.*\(4, 37\)"):
        task.reward(np.zeros((4, 37)))
