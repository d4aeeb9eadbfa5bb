"""Spreads, operation counts, extrapolation and the cutting of recorded actions, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.evaluation import by_episode
from benchmarks.flops import Dense, update_flops
from benchmarks.loop import summarise
from benchmarks.ours import make_updater
from benchmarks.paper_preset import extrapolate
from benchmarks.statistics import rounded, spread


def test_a_spread_is_the_median_and_the_quartiles():
    # Sorted 1 2 3 4 10: median 3, quartiles at positions 1 and 3.
    found = spread([10.0, 1.0, 3.0, 2.0, 4.0], scale=1e3)
    assert (found.low, found.median, found.high, found.rounds) == (2e3, 3e3, 4e3, 5)


def test_one_sample_is_its_own_spread():
    assert spread([0.5]).as_json("s") == {
        "median": 0.5,
        "quartile_1": 0.5,
        "quartile_3": 0.5,
        "rounds": 1,
        "unit": "s",
    }


def test_no_sample_has_no_spread():
    with pytest.raises(ValueError, match="at least one"):
        spread([])


def test_numbers_are_rounded_to_significant_digits():
    assert (rounded(123456.0), rounded(0.00123456), rounded(1.5, 1)) == (123500.0, 0.001235, 2.0)
    with pytest.raises(ValueError, match="finite"):
        rounded(math.nan)


def test_operations_of_a_dense_network():
    net = Dense((2, 3, 5))  # weights 6 + 15 = 21, first layer 6
    assert net.forward(7) == 2 * 7 * 21
    assert net.weight_gradient(7) == 2 * 7 * 21 + 2 * 7 * 15
    assert net.input_gradient(7) == 2 * 7 * 21


def test_operations_of_an_update():
    # Observation 2, action 1, width 3: actor 2-3-3-2 has 21 weights, 6 in the first layer;
    # a critic 3-3-3-1 has 21 weights, 9 in the first. One critic, 10 rows, 5 more for imitation:
    # target 420 + 420; critic 420 + 420 + 240; its value of the policy 420 + 420;
    # actor on 15 rows 630 + 630 + 450.
    found = update_flops(3, 10, demo_rows=5, num_critics=1, observation=2, action=1)
    assert found == 840 + 1080 + 840 + 1710


def test_an_update_of_ours_does_what_is_counted():
    width, batch = 32, 16
    overrides = [
        "variant=bc_sac",
        "preset=paper",
        f"actor.hidden=[{width},{width}]",
        f"critic.hidden=[{width},{width}]",
        f"sampler.batch_size={batch}",
        "compile_updates=false",  # the compiler computes too
    ]
    updater = make_updater(overrides, "fp32", replay_rows=200, demo_rows=200)
    updater.call()  # the first update also takes the two gradients apart, once in a hundred
    with FlopCounterMode(display=False) as counter:
        updater.call()
    counted = counter.get_total_flops()
    # An implementation may spend a little more (a gradient of an input that nobody uses).
    assert counted == pytest.approx(update_flops(width, batch, demo_rows=batch), rel=0.1)
    assert torch.isfinite(updater.stepper.last["loss_qvalue"])


def test_da_sac_counts_its_extra_updates_as_updates():
    overrides = ["variant=da_sac", "preset=paper", "actor.hidden=[8]", "critic.hidden=[8]"]
    overrides += ["sampler.batch_size=4", "compile_updates=false"]
    updater = make_updater(overrides, "fp32", replay_rows=200, demo_rows=200, updates=2)
    before = updater.stepper.critic_updates
    updater.call()
    assert updater.stepper.critic_updates - before == updater.units == 3


def test_a_whole_run_is_extrapolated_from_its_parts():
    timed = {
        "opening_s": 8.0,
        "random_frames": 10.0,
        "random_s": 1.0,
        "learning_frames": 20.0,
        "learning_s": 4.0,
        "closing_s": 6.0,
    }
    # 8 s + 0.1 s x 1000 + 0.2 s x 9000 + 6 s x 2 = 1920 s.
    found = extrapolate(timed, total_frames=10_000, random_frames=1_000, evaluations=2)
    assert found["hours"] == pytest.approx(1920 / 3600, abs=1e-3)
    assert found["ms_per_learning_frame"] == 200.0


def test_recorded_actions_are_cut_into_episodes():
    # Waves of 2 doors; the first takes 3 steps, the second 2. An action is 10 x wave + step.
    actions = [np.full((2, 1), v, dtype=np.float32) for v in (10, 11, 12, 20, 21)]
    episodes = by_episode(actions, np.array([1, 3, 2]), batch=2)
    assert [e.ravel().tolist() for e in episodes] == [[10], [10, 11, 12], [20, 21]]


def test_the_breakdown_of_a_training_run():
    parts = {"physics": 2.0, "evaluate": 1.0, "update": 4.0, "log": 1.0, "setup": 2.0}
    found = summarise({"wall_s": 10.0, "parts_s": parts}, frames=1000)
    assert found["productive_share"] == 0.7
    assert found["overhead_share"] == 0.3
    assert found["frames_per_s"] == 100.0


def test_a_breakdown_that_does_not_sum_is_refused():
    with pytest.raises(ValueError, match=r"sum to 9\.00 s, but wall_s is 10\.00"):
        summarise({"wall_s": 10.0, "parts_s": {"update": 9.0}}, frames=10)
