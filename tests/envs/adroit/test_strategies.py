"""Strategies told from constructed contacts; the travel is worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from envs import find_task
from envs.adroit.strategies import DEFAULT, SENSITIVITY, STRATEGIES, HandStrategies
from envs.adroit.touch import FORCES, OPPOSITION, Contacts
from envs.strategies import Ways, shares
from tests.envs.adroit.conftest import HANDS

CONTACTS = Contacts(
    parts=("palm", "thumb", "first"),
    thumb="thumb",
    targets=("handle", "edge"),
    held=("handle",),
    begins=0.05,
    moved=0.2,
    words={name: name for name in STRATEGIES},
)
PALM, THUMB, FIRST = range(3)
HANDLE, EDGE = range(2)
# Steps 2 to 9 add 0.1 and seven times 0.2: a travel of 1.5.
OPENING = np.array([0.0, 0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5])
EXACT = replace(DEFAULT, gap=0)
ALL = range(10)


def episode(
    touches: dict[tuple[int, int], range],
    opposed: range = range(0),
    progress: np.ndarray = OPENING,
    newtons: float = 1.0,
    at=EXACT,
) -> Ways:
    """One episode in which these parts touch these targets at these steps."""
    forces, opposition = np.zeros((1, 10, 3, 2), np.float32), np.zeros((1, 10), np.float32)
    for (part, target), steps in touches.items():
        forces[0, list(steps), part, target] = newtons
    opposition[0, list(opposed)] = -1.0
    return told(forces, opposition, progress[None], at)


def told(forces: np.ndarray, opposition: np.ndarray, progress: np.ndarray, at=DEFAULT) -> Ways:
    """As environments write it: all parts and targets in one row."""
    seen = {FORCES: forces.reshape(*forces.shape[:2], -1), OPPOSITION: opposition[..., None]}
    with np.errstate(invalid="ignore"):
        return HandStrategies(CONTACTS, at).told(seen, progress, progress > 1.4)


def number(found: Ways, column: str) -> list[float]:
    return [np.nan if value is None else value for value in found.columns[column]]


GRASP = {(THUMB, HANDLE): ALL, (FIRST, HANDLE): ALL}


@pytest.mark.parametrize(
    ("found", "name", "untouched", "last"),
    [
        (episode(GRASP, ALL), "grasp", 0.0, 1.5),
        # Opposed while the travel is 0.1 + 5 * 0.2 = 1.1, which is 0.73 of it; without two, 0.47.
        (episode(GRASP, range(8)), "grasp", 0.0, 1.5),
        (episode(GRASP, range(6)), "held", 0.0, 1.5),
        # A thumb alone, and pushes from one side, hold nothing between them.
        (episode({(THUMB, HANDLE): ALL}, ALL), "held", 0.0, 1.5),
        (episode(GRASP), "held", 0.0, 1.5),
        # Let go behind step 6, at 0.9: 0.6 of 1.5 are left.
        (episode({(PALM, HANDLE): range(7)}), "flung", 0.4, 0.9),
        # Let go behind step 8: 0.2 of 1.5.
        (episode({(PALM, HANDLE): range(9)}), "held", 0.2 / 1.5, 1.3),
        # At the edge from step 6 on: 0.8 of 1.5.
        (episode({(PALM, HANDLE): range(6), (PALM, EDGE): range(6, 10)}), "elsewhere", 0.0, 0.7),
        # Both at once is led.
        (episode({(PALM, HANDLE): ALL, (FIRST, EDGE): ALL}), "held", 0.0, 1.5),
        (episode({(PALM, HANDLE): ALL}, progress=OPENING / 2), "short", 0.0, 0.75),
        (episode({(PALM, HANDLE): range(3)}, progress=OPENING / 10), "touched", np.nan, 0.01),
        (episode({(PALM, EDGE): ALL}, progress=OPENING / 10), "untouched", np.nan, np.nan),
        # 0.04 N is no touch.
        (episode({(PALM, HANDLE): ALL}, newtons=0.04), "flung", 1.0, np.nan),
    ],
)
def test_each_class(found: Ways, name: str, untouched: float, last: float):
    assert found.names == [name]
    assert number(found, "travel_untouched") == pytest.approx([untouched], nan_ok=True)
    assert number(found, "progress_at_last_contact") == pytest.approx([last], nan_ok=True)


def test_a_gap_between_touches_is_closed():
    """Let go behind step 6; two steps longer leave 0.2 of the travel."""
    found = episode({(PALM, HANDLE): range(7)}, at=DEFAULT)
    assert found.names == ["held"]
    assert number(found, "travel_untouched") == pytest.approx([0.2 / 1.5])
    assert number(found, "progress_at_last_contact") == pytest.approx(
        [0.9]
    )  # is when it was touched indeed


def test_what_a_closed_door_gives_is_no_travel():
    """The first 0.04 are below where the travel begins, and nobody touches it there."""
    progress = OPENING.copy()
    progress[1] = 0.04
    found = episode({(PALM, HANDLE): range(2, 10)}, progress=progress)
    assert number(found, "travel_untouched") == pytest.approx([0.0])


def test_what_happens_behind_the_success_does_not_count():
    progress = np.array([0.0, 0.1, 0.8, 1.5, 1.55, 1.56, 1.57, 1.57, np.nan, np.nan])
    found = episode({(PALM, HANDLE): range(4)}, progress=progress)
    assert found.names == ["held"]
    assert number(found, "progress_at_last_contact") == pytest.approx([1.5])


def test_shares_at_other_thresholds():
    found = episode({(PALM, HANDLE): range(7)})  # 0.4 of its travel untouched
    of_untouched = found.figures["sensitivity"]["untouched"]
    assert {value: of["flung"] for value, of in of_untouched.items()} == {
        "0.1": 1.0, "0.25": 1.0, "0.5": 0.0,
    }  # fmt: skip
    assert found.figures["sensitivity"]["gap"]["5"]["flung"] == 0.0
    assert set(found.figures["sensitivity"]) == set(SENSITIVITY)


def test_figures_and_columns():
    """Of two episodes: by all that touch the handle, and let go at 0.9 of 1.5."""
    forces, opposition = np.zeros((2, 10, 3, 2), np.float32), np.zeros((2, 10), np.float32)
    forces[0, :, [THUMB, FIRST], HANDLE] = 1.0
    opposition[0] = -1.0
    forces[1, :7, THUMB, HANDLE] = 1.0
    forces[1, :7, PALM, EDGE] = 9.0  # is not what is held
    both = told(forces, opposition, np.stack([OPENING, OPENING]), replace(EXACT, elsewhere=1.0))
    assert both.names == ["grasp", "flung"]
    assert both.figures["travel_untouched_mean"] == pytest.approx(0.2)
    # 10 and 7 steps of the thumb, 10 of the first finger.
    assert both.figures["force_by_part"] == pytest.approx(
        {"palm": 0.0, "thumb": 17 / 27, "first": 10 / 27}
    )
    assert both.columns["progress_at_last_contact"] == pytest.approx([1.5, 0.9])
    assert both.columns["travel_untouched"] == pytest.approx([0.0, 0.4])
    assert episode({}, progress=OPENING / 10).columns == {
        "progress_at_last_contact": [None], "travel_untouched": [None],
    }  # fmt: skip


@pytest.mark.parametrize("hand", HANDS)
def test_every_hand_task_has_a_word_for_each_class_in_their_order(hand: str):
    assert tuple(find_task(hand).strategies.words) == STRATEGIES


@given(
    forces=arrays(np.float32, (3, 10, 3, 2), elements=st.floats(0, 2, width=32)),
    opposition=arrays(np.float32, (3, 10), elements=st.floats(-1, 1, width=32)),
    progress=arrays(np.float64, (3, 10), elements=st.floats(0, 2)),
)
def test_every_episode_has_one_strategy(forces, opposition, progress):
    found = told(forces, opposition, progress)
    assert set(found.names) <= set(STRATEGIES)
    of_names = shares(found.names, STRATEGIES)
    for of in (of_names, *found.figures["sensitivity"]["grasp"].values()):
        assert sum(of.values()) == pytest.approx(1.0)
    assert found.figures["sensitivity"]["gap"]["2"] == of_names  # the threshold in use
    known = [share for share in found.columns["travel_untouched"] if share is not None]
    assert all(0 <= share <= 1 + 1e-9 for share in known)


def test_names_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="knob"):
        replace(CONTACTS, held=("knob",))
    with pytest.raises(ValueError, match="toe"):
        replace(CONTACTS, thumb="toe")
