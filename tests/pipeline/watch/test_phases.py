"""The lines that a run says of itself."""

from __future__ import annotations

import pytest

from pipeline.watch.phases import duration, evaluated, outcome


@pytest.mark.parametrize(
    ("seconds", "told"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min 0 s"),
        (75.0, "1 min 15 s"),
        (7380.0, "2 h 3 min"),
    ],
)
def test_durations_have_two_units_at_most(seconds: float, told: str):
    assert duration(seconds) == told


def test_an_evaluation_is_a_line():
    figures = {"success_once": 0.62, "return_mean": 812.3}
    line = evaluated(2000, 100_000, "frames", 75.0, figures)
    assert line == "2,000 of 100,000 frames, 1 min 15 s: success 62 %, return 812.3"


def test_a_task_without_success_tells_its_return_alone():
    assert outcome({"success_once": None, "return_mean": -3.0}) == "return -3"


def test_nothing_is_said_of_a_run_that_was_not_evaluated():
    assert outcome({}) == ""
