"""The alarm on learning curves written by hand."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.watch.alarm import unlearning

HEALTHY: dict[str, Any] = {
    "actor_updates": 1000.0,
    "q_demo_actions": 10.0,
    "q_policy_actions": 10.5,
    "entropy": -40.0,
    "bc_nll_train": -40.0,
    "bc_weight": 1.0,
    "grad_norm_bc": 2.0,
    "grad_norm_rl": 1.0,
}


def row(frames: int, success: float | None, **changes: float) -> dict[str, Any]:
    """Evaluation in which every episode that takes hold succeeds; all come near."""
    stages = {"near": 1.0, "holds": success, "done": success}
    return {"frames": frames, "success_once": success, "stages": stages, **HEALTHY, **changes}


def causes(**changes: Any) -> str:
    alarm = unlearning([row(0, 0.8), row(5000, 0.3, **changes)])
    assert alarm is not None
    return "; ".join(alarm.causes)


def test_half_of_the_best_success_raises_it():
    alarm = unlearning([row(0, 0.6), row(100, 0.8), row(200, 0.7), row(300, 0.4)])
    assert alarm is not None
    assert (alarm.success, alarm.best_success) == (0.4, 0.8)
    assert (alarm.frames, alarm.best_frames) == (300, 100)
    assert "40% of the episodes succeed at 300 frames, 80% at 100" in str(alarm)


def test_rows_are_read_by_their_frames_and_those_that_come_twice_once():
    rows = [row(300, 0.4), row(0, 0.6), row(200, 0.2), row(100, 0.8), row(200, 0.7)]
    alarm = unlearning(rows)
    assert alarm is not None
    assert (alarm.frames, alarm.best_frames) == (300, 100)
    assert unlearning([row(100, 0.4), row(0, 0.2)]) is None


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
    behaviour_cloning = [{"frames": i, "success_once": s} for i, s in enumerate((0.8, 0.1))]
    assert unlearning(behaviour_cloning) is None


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"q_policy_actions": 11.6}, "overestimation"),
        ({"entropy": -34.0}, "entropy bonus"),
        ({"bc_weight": 0.1}, "faded imitation"),
        ({"bc_nll_train": -34.0}, "leaving the demonstrations"),
        # At the best 20 % come near and do not hold, now 70 %: all of the 50 % that are lost.
        ({}, "stopping before 'holds' (of the 50% lost, 50% get as far as 'near'"),
        # 40 % do not come near, 10 % do not hold (20 % before), 20 % hold and are not done.
        (
            {"stages": {"near": 0.6, "holds": 0.5, "done": 0.3}},
            "stopping before 'near' (of the 50% lost, 40% get as far as 'the start'",
        ),
        (
            {"stages": {"near": 1.0, "holds": 0.6, "done": 0.3}},
            "stopping before 'done' (of the 50% lost, 30% get as far as 'holds'",
        ),
        (
            {"train_success": 0.6},
            "the evaluated action alone (training's samples succeed in 60% there",
        ),
    ],
)
def test_it_names_the_cause(changes: dict[str, Any], cause: str):
    assert causes(**changes).startswith(cause)


def test_small_changes_are_no_causes():
    small = {"q_policy_actions": 11.4, "entropy": -35.5, "bc_weight": 0.3, "bc_nll_train": -35.5}
    spread = {"near": 0.85, "holds": 0.5, "done": 0.3}  # 15 %, 15 % and 20 % more stop at each
    assert causes(**small, stages=spread, train_success=0.5) == "none of the known causes"


def test_several_causes_are_all_named():
    found = causes(q_policy_actions=20.0, bc_weight=0.0)
    assert found.index("overestimation") < found.index("faded imitation")


def test_a_run_without_demonstrations_is_judged_by_what_it_has():
    curve = [
        {"frames": 0, "success_once": 0.8, "actor_updates": 9.0, "entropy": -40.0},
        {"frames": 1, "success_once": 0.1, "actor_updates": 99.0, "entropy": -10.0},
    ]
    alarm = unlearning(curve)
    assert alarm is not None
    assert len(alarm.causes) == 1
    assert "30.0 nats" in alarm.causes[0]
