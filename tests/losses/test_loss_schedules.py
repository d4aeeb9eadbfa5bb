"""Schedules: values by hand, invariants, and errors that name the setting."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from losses import (
    SCHEDULES,
    ConstantWeight,
    CosineWeight,
    ExponentialWeight,
    LinearWeight,
    PiecewiseWeight,
    Schedule,
    make_schedule,
)

WEIGHTS = st.floats(0.0, 100.0)
UPDATES = st.integers(0, 10_000)


@pytest.mark.parametrize(
    ("schedule", "updates", "weight"),
    [
        (ConstantWeight(0.1), 0, 0.1),
        (ConstantWeight(0.1), 10**6, 0.1),
        (ExponentialWeight(2.0, 0.5), 0, 2.0),
        (ExponentialWeight(2.0, 0.5), 3, 0.25),
        (ExponentialWeight(1.0, 0.0), 0, 1.0),
        (ExponentialWeight(1.0, 0.0), 1, 0.0),
        (LinearWeight(2.0, 1.0, 4), 1, 1.75),
        (LinearWeight(2.0, 1.0, 4), 4, 1.0),
        (LinearWeight(2.0, 1.0, 4), 9, 1.0),
        (CosineWeight(2.0, 1.0, 4), 0, 2.0),
        (CosineWeight(2.0, 1.0, 4), 1, 1.0 + (2**0.5 + 2) / 4),
        (CosineWeight(2.0, 1.0, 4), 2, 1.5),
        (CosineWeight(2.0, 1.0, 4), 9, 1.0),
        (PiecewiseWeight((10, 20), (3.0, 2.0, 1.0)), 0, 3.0),
        (PiecewiseWeight((10, 20), (3.0, 2.0, 1.0)), 9, 3.0),
        (PiecewiseWeight((10, 20), (3.0, 2.0, 1.0)), 10, 2.0),
        (PiecewiseWeight((10, 20), (3.0, 2.0, 1.0)), 20, 1.0),
        (PiecewiseWeight((), (3.0,)), 5, 3.0),
    ],
)
def test_weight_by_hand(schedule: Schedule, updates: int, weight: float) -> None:
    assert schedule(updates) == pytest.approx(weight)


def test_the_paper_s_schedule_halves_about_every_693_updates() -> None:
    # ln 2 / -ln 0.999 = 692.8
    assert ExponentialWeight(1.0, 0.999)(693) == pytest.approx(0.5, abs=2e-4)


@given(init=WEIGHTS, decay=st.floats(0.0, 1.0), updates=UPDATES)
def test_exponential_weight_has_one_factor_per_update(
    init: float, decay: float, updates: int
) -> None:
    schedule = ExponentialWeight(init, decay)
    assert schedule(updates + 1) == pytest.approx(decay * schedule(updates), abs=1e-12)


@given(
    kind=st.sampled_from([LinearWeight, CosineWeight]),
    init=WEIGHTS,
    final=WEIGHTS,
    duration=st.integers(1, 1000),
    updates=UPDATES,
)
def test_ramps_start_and_end_exactly_and_never_turn(
    kind: type[LinearWeight | CosineWeight],
    init: float,
    final: float,
    duration: int,
    updates: int,
) -> None:
    schedule = kind(init, final, duration)
    assert schedule(0) == init
    assert schedule(duration) == schedule(duration + updates) == final
    towards_final = (final - init) * (schedule(updates + 1) - schedule(updates))
    assert towards_final >= -1e-9


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("constant", {"init": 1.0}),
        ("exponential", {"init": 1.0, "decay": 0.999}),
        ("linear", {"init": 1.0, "final": 0.0, "duration": 10}),
        ("cosine", {"init": 1.0, "final": 0.0, "duration": 10}),
        ("piecewise", {"milestones": [5], "values": [1.0, 0.0]}),
    ],
)
def test_make_schedule_builds_the_named_class(kind: str, options: dict[str, object]) -> None:
    schedule = make_schedule(kind, **options)
    assert type(schedule) is SCHEDULES[kind]
    assert schedule == SCHEDULES[kind](**options)
    hash(schedule)  # a list from a configuration has become a tuple


def test_every_schedule_is_tested_above() -> None:
    assert set(SCHEDULES) == {"constant", "exponential", "linear", "cosine", "piecewise"}


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("expnential", {}, "unknown schedule 'expnential'.*exponential"),
        ("constant", {"weight": 1.0}, "exactly init; got weight"),
        ("exponential", {"init": 1.0}, "exactly init, decay; got init"),
        ("constant", {}, "got none"),
        ("constant", {"init": -1.0}, "init is a weight.*-1.0"),
        ("constant", {"init": float("nan")}, "finite"),
        ("exponential", {"init": float("inf"), "decay": 0.9}, "init is a weight"),
        ("exponential", {"init": 1.0, "decay": 1.001}, r"decay is a factor.*\[0, 1\].*1.001"),
        ("linear", {"init": 1.0, "final": -1.0, "duration": 3}, "final is a weight"),
        ("linear", {"init": 1.0, "final": 0.0, "duration": 0}, "duration.*>= 1, got 0"),
        ("cosine", {"init": 1.0, "final": -2.0, "duration": 3}, "final is a weight"),
        ("cosine", {"init": 1.0, "final": 0.0, "duration": 0}, "duration.*>= 1, got 0"),
        ("piecewise", {"milestones": [5], "values": [1.0]}, "one more than milestones"),
        ("piecewise", {"milestones": [5, 5], "values": [1.0, 1.0, 1.0]}, "increasing"),
        ("piecewise", {"milestones": [0], "values": [1.0, 1.0]}, ">= 1"),
        ("piecewise", {"milestones": [5], "values": [1.0, -1.0]}, r"values\[1\] is a weight"),
    ],
)
def test_a_bad_setting_is_named(kind: str, options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_schedule(kind, **options)
