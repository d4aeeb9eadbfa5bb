"""Schedules: values by hand, invariants, and errors that name the setting."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from losses import (
    SCHEDULES,
    CosineWeight,
    ExponentialWeight,
    LinearWeight,
    PiecewiseWeight,
    make_schedule,
)
from losses.schedules import schedule_kind

WEIGHTS = st.floats(0.0, 100.0)
UPDATES = st.integers(0, 10_000)


CASES: dict[str, tuple[dict[str, object], dict[int, float]]] = {
    "constant": ({"init": 0.1}, {0: 0.1, 10**6: 0.1}),
    "exponential": ({"init": 2.0, "decay": 0.5}, {0: 2.0, 1: 1.0, 3: 0.25}),
    "linear": ({"init": 2.0, "final": 1.0, "duration": 4}, {0: 2.0, 1: 1.75, 4: 1.0, 9: 1.0}),
    "cosine": (
        {"init": 2.0, "final": 1.0, "duration": 4},
        {0: 2.0, 1: 1.0 + (2**0.5 + 2) / 4, 2: 1.5, 9: 1.0},
    ),
    "piecewise": (
        {"milestones": [10, 20], "values": [3.0, 2.0, 1.0]},
        {0: 3.0, 9: 3.0, 10: 2.0, 19: 2.0, 20: 1.0},
    ),
}
"""Settings by kind, as a configuration gives them, and weights by the number of updates."""


@pytest.mark.parametrize("kind", CASES)
def test_weights_by_hand(kind: str) -> None:
    options, weights = CASES[kind]
    schedule = make_schedule(kind, **options)
    assert {updates: schedule(updates) for updates in weights} == pytest.approx(weights)
    hash(schedule)  # a list from a configuration has become a tuple
    assert schedule_kind(schedule) == kind


def test_every_schedule_has_a_case() -> None:
    assert CASES.keys() == SCHEDULES.keys()


def test_schedules_at_the_edges_of_their_settings() -> None:
    without_memory = ExponentialWeight(1.0, 0.0)
    assert (without_memory(0), without_memory(1)) == (1.0, 0.0)
    assert PiecewiseWeight((), (3.0,))(5) == 3.0


def test_another_callable_has_no_kind() -> None:
    with pytest.raises(ValueError, match=r"is none of ConstantWeight, .*, PiecewiseWeight"):
        schedule_kind(lambda _updates: 1.0)


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
