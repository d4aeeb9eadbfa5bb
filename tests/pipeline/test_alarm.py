"""The alarm on learning curves written by hand."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.alarm import unlearning

HEALTHY: dict[str, Any] = {
    "actor_updates": 1000.0,
    "q_demo_actions": 10.0,
    "q_policy_actions": 10.5,
    "entropy": -40.0,
    "bc_nll_train": -40.0,
    "bc_weight": 1.0,
    "grad_norm_bc": 2.0,
    "grad_norm_rl": 1.0,
    "share_reached": 1.0,
    "share_latch_turned": 0.9,
}


def row(frames: int, success: float | None, **changes: float) -> dict[str, Any]:
    """Evaluation in which every door that moves opens."""
    shares = {"share_gt_1_35": success, "share_gt_0_2": success}
    return {"frames": frames, **shares, **HEALTHY, **changes}


def causes(**changes: float) -> str:
    alarm = unlearning([row(0, 0.8), row(5000, 0.3, **changes)])
    assert alarm is not None
    return "; ".join(alarm.causes)


def test_half_of_the_best_success_raises_it():
    alarm = unlearning([row(0, 0.6), row(100, 0.8), row(200, 0.7), row(300, 0.4)])
    assert alarm is not None
    assert (alarm.success, alarm.best_success) == (0.4, 0.8)
    assert (alarm.frames, alarm.best_frames) == (300, 100)
    assert "40% of the doors above 1.35 rad at 300 frames, 80% at 100" in str(alarm)


@pytest.mark.parametrize(
    "successes",
    [(0.8, 0.41), (0.18, 0.0), (0.8,), (0.2, 0.8), (0.8, 0.1, 0.2), (None, None)],
    ids=["a smaller fall", "hardly any", "one row", "a rise", "fallen before", "other tasks"],
)
def test_nothing_else_does(successes: tuple[float | None, ...]):
    assert unlearning([row(100 * i, success) for i, success in enumerate(successes)]) is None


def test_a_second_fall_after_a_recovery_raises_it_again():
    assert unlearning([row(i, s) for i, s in enumerate((0.8, 0.1, 0.9, 0.2))]) is not None


def test_before_the_first_actor_update_there_is_nothing_to_blame():
    assert unlearning([row(0, 0.8), row(100, 0.1, actor_updates=0.0)]) is None
    behaviour_cloning = [{"frames": i, "share_gt_1_35": s} for i, s in enumerate((0.8, 0.1))]
    assert unlearning(behaviour_cloning) is None


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"q_policy_actions": 11.6}, "overestimation"),
        ({"entropy": -34.0}, "entropy bonus"),
        ({"bc_weight": 0.1}, "faded imitation"),
        ({"bc_nll_train": -34.0}, "leaving the demonstrations"),
        ({"share_latch_turned": 0.4}, "a stall of the evaluated action"),
        ({"train_success": 0.6}, "the evaluated action alone (training's samples open 60% of the"),
        ({"share_gt_0_2": 0.6}, "letting go of the door (of the 50% lost, 30% move"),
    ],
)
def test_it_names_the_cause(changes: dict[str, float], cause: str):
    assert causes(**changes).startswith(cause)


def test_small_changes_are_no_causes():
    small = {"q_policy_actions": 11.4, "entropy": -35.5, "bc_weight": 0.3, "bc_nll_train": -35.5}
    assert causes(**small, share_gt_0_2=0.5, train_success=0.5) == "none of the known causes"


def test_several_causes_are_all_named():
    found = causes(q_policy_actions=20.0, bc_weight=0.0)
    assert found.index("overestimation") < found.index("faded imitation")


def test_a_run_without_demonstrations_is_judged_by_what_it_has():
    curve = [
        {"frames": 0, "share_gt_1_35": 0.8, "actor_updates": 9.0, "entropy": -40.0},
        {"frames": 1, "share_gt_1_35": 0.1, "actor_updates": 99.0, "entropy": -10.0},
    ]
    alarm = unlearning(curve)
    assert alarm is not None
    assert len(alarm.causes) == 1
    assert "30.0 nats" in alarm.causes[0]
