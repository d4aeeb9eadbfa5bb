from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from envs.adroit.simulator import HandSimulator
from envs.door.hand import DOOR, DOOR_POSITION
from envs.door.metrics import DAPG_SUCCESS_STEPS, ZERO_TOLERANCE_RAD, summarise
from tests.envs.door.conftest import PROPERTY, door_position


def episodes_by_hand():
    """Four episodes of up to 40 steps.

    0: never moves; 1: half open from step 3, closes; 2: open from step 5 for 35 steps (> 25),
    closed at its last; 3: open from step 11 to its end at step 20 (10 steps).
    """
    angle = np.full((4, 40), 0.012)
    angle[1, 2:6] = 0.5
    angle[2, 4:39] = 1.5
    angle[3, 10:20] = 1.4
    angle[3, 20:] = np.nan
    return angle, [40, 40, 40, 20]


def test_summary_by_hand():
    metrics = summarise(*episodes_by_hand())
    assert metrics.angle_mean_deg == pytest.approx((0.012 + 0.5 + 1.5 + 1.4) / 4 * 180 / math.pi)
    assert metrics.angle_mean_deg_opened == pytest.approx((0.5 + 1.5 + 1.4) / 3 * 180 / math.pi)
    assert metrics.share_gt_0 == 0.75
    assert metrics.share_gt_0_2 == 0.75
    assert metrics.share_gt_1_0 == 0.5
    assert metrics.share_gt_1_35 == 0.5
    assert metrics.success_dapg == 0.25
    assert metrics.steps_to_open_median == (5 + 11) / 2


def test_wilson_interval_by_hand():
    # Wilson, n = 4, p = 1/2, z = 1.959964: centre 1/2, half-width
    # z / (1 + z^2/4) * sqrt(1/16 + z^2/64) = 1.959964 / 1.960365 * 0.350036 = 0.349964
    low, high = summarise(*episodes_by_hand()).share_gt_1_35_ci95
    assert (low, high) == pytest.approx((0.150036, 0.849964), abs=1e-5)


def test_the_literal_reading_of_above_zero():
    metrics = summarise(*episodes_by_hand(), zero_tolerance_rad=0.0)
    assert metrics.share_gt_0 == 1.0
    assert metrics.angle_mean_deg_opened == metrics.angle_mean_deg


def test_nothing_opened():
    metrics = summarise(np.zeros((2, 3)), [3, 3])
    assert metrics.angle_mean_deg_opened is None
    assert metrics.steps_to_open_median is None
    assert metrics.share_gt_0 == 0.0


@pytest.mark.parametrize(("steps", "expected"), [(25, 0.0), (26, 1.0)])
def test_dapg_success_needs_more_than_25_steps(steps, expected):
    assert DAPG_SUCCESS_STEPS == 25
    angle = np.zeros((1, 60))
    angle[0, :steps] = 1.4
    assert summarise(angle, [60]).success_dapg == expected


angles = npst.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 40)),
                     elements=st.floats(-0.02, 1.6))  # fmt: skip


@PROPERTY
@given(angles, st.randoms(use_true_random=False))
def test_invariants(angle, random):
    episodes, horizon = angle.shape
    lengths = np.array([random.randint(1, horizon) for _ in range(episodes)])
    metrics = summarise(angle, lengths)
    values = dataclasses.asdict(metrics)
    shares = [values[f"share_gt_{level}"] for level in ("0", "0_2", "1_0", "1_35")]
    assert shares == sorted(shares, reverse=True)
    for key in [name for name in values if name.endswith("_ci95")]:
        low, high = values[key]
        assert -1e-12 <= low <= values[key.removesuffix("_ci95")] <= high <= 1 + 1e-12
    assert metrics.success_dapg <= metrics.share_gt_1_35

    order = list(range(episodes))
    random.shuffle(order)
    shuffled = summarise(angle[order], lengths[order])
    for name, value in dataclasses.asdict(shuffled).items():
        assert value == pytest.approx(values[name]), name

    garbage = np.where(np.arange(horizon) < lengths[:, None], angle, np.nan)
    assert summarise(garbage, lengths) == metrics


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((0, 3)), []), "not empty"),
        ((np.zeros(3), [3]), "not empty"),
        ((np.zeros((2, 3)), [3]), r"shape \(2,\)"),
        ((np.zeros((1, 3)), [4]), r"1\.\.3"),
        ((np.zeros((1, 3)), [0]), r"1\.\.3"),
        ((np.full((1, 3), np.nan), [3]), "NaN or infinite"),
    ],
)
def test_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        summarise(*arguments)


def test_a_latched_door_stays_below_the_tolerance(rng):
    """Random hands that never turn the latch past 0.5 rad do not count as having opened it."""
    with HandSimulator(DOOR, 24) as simulator:
        simulator.start({DOOR_POSITION: [door_position(3, door, 0) for door in range(24)]})
        angles = []
        for step in range(120):
            if step % 20 == 0:
                action = rng.uniform(-1, 1, (24, 28))
            angles.append(simulator.step(action)[:, [27, 28]])
    latch, hinge = np.max(angles, axis=0).T
    untouched = hinge[latch < 0.5]
    assert len(untouched) >= 12
    assert untouched.max() < ZERO_TOLERANCE_RAD
    # The reason for a tolerance at all: none of them is at 0.
    assert untouched.min() > 0.01


def test_an_unlatched_door_passes_the_tolerance(one_door):
    """A gentle pull (5 N m) carries a free door past it within a quarter of a second."""
    qpos = np.zeros((1, 30))
    qpos[0, 29] = 1.2
    one_door.start({DOOR_POSITION: [[-0.25, 0.3, 0.3]]}, qpos=qpos)
    pulled = one_door.data(0)
    pulled.joint("door_hinge").qfrc_applied[:] = 5.0
    state = one_door.get_state()
    mujoco.mj_getState(
        one_door.scene.model, pulled, state["physics"][0], mujoco.mjtState.mjSTATE_INTEGRATION
    )
    one_door.set_state(state)
    for _ in range(25):
        observation = one_door.step(np.zeros((1, 28)))
    assert observation[0, 28] > ZERO_TOLERANCE_RAD


def test_stages_before_the_door_moves_by_hand():
    metrics = summarise(
        *episodes_by_hand(),
        reached=[False, False, False, True],
        latch_turned=[False, False, False, True],
    )
    assert metrics.share_reached == 0.25
    assert metrics.share_latch_turned == 0.25
    without = summarise(*episodes_by_hand())
    assert (without.share_reached, without.share_latch_turned) == (None, None)
