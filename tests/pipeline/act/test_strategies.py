"""Strategies told from constructed contacts; the travel is worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from envs.contacts import Contacts
from pipeline.act.strategies import DEFAULT, SENSITIVITY, STRATEGIES, Strategies, told

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
) -> Strategies:
    """One episode in which these parts touch these targets at these steps."""
    forces, opposition = np.zeros((1, 10, 3, 2), np.float32), np.zeros((1, 10), np.float32)
    for (part, target), steps in touches.items():
        forces[0, list(steps), part, target] = newtons
    opposition[0, list(opposed)] = -1.0
    return told(CONTACTS, forces, opposition, progress[None], progress[None] > 1.4, at)


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
def test_each_class(found: Strategies, name: str, untouched: float, last: float):
    assert found.names == [name]
    assert found.untouched == pytest.approx([untouched], nan_ok=True)
    assert found.last_contact == pytest.approx([last], nan_ok=True)


def test_a_gap_between_touches_is_closed():
    """Let go behind step 6; two steps longer leave 0.2 of the travel."""
    found = episode({(PALM, HANDLE): range(7)}, at=DEFAULT)
    assert found.names == ["held"]
    assert found.untouched == pytest.approx([0.2 / 1.5])
    assert found.last_contact == pytest.approx([0.9])  # is when it was touched indeed


def test_what_a_closed_door_gives_is_no_travel():
    """The first 0.04 are below where the travel begins, and nobody touches it there."""
    progress = OPENING.copy()
    progress[1] = 0.04
    found = episode({(PALM, HANDLE): range(2, 10)}, progress=progress)
    assert found.untouched == pytest.approx([0.0])


def test_an_episode_that_succeeded_and_did_not_stay_so_is_lost_whatever_its_class():
    shut = np.array([0.0, 0.1, 0.8, 1.5, 1.55, 1.3, 0.9, 0.3, np.nan, np.nan])
    open_ = np.array([0.0, 0.1, 0.8, 1.5, 1.3, 1.3, 1.45, 1.5, np.nan, np.nan])
    progress = np.stack([shut, open_, OPENING / 2])
    forces, opposition = np.zeros((3, 10, 3, 2), np.float32), np.zeros((3, 10), np.float32)
    forces[:, :, PALM, HANDLE] = 1.0
    with np.errstate(invalid="ignore"):
        found = told(CONTACTS, forces, opposition, progress, progress > 1.4, EXACT)
    assert found.names == ["held", "held", "short"]
    figures = found.figures(CONTACTS)
    assert figures["kept_at_end"] == {
        **dict.fromkeys(STRATEGIES), "held": 0.5, "short": 0.0,
    }  # fmt: skip
    assert figures["lost_at_end"] == pytest.approx(1 / 3)
    # Wilson's interval of 1 of 3.
    assert figures["lost_at_end_ci95"] == pytest.approx([0.0615, 0.7923], abs=1e-3)


def test_what_happens_behind_the_success_does_not_count():
    progress = np.array([0.0, 0.1, 0.8, 1.5, 1.55, 1.56, 1.57, 1.57, np.nan, np.nan])
    with np.errstate(invalid="ignore"):
        found = episode({(PALM, HANDLE): range(4)}, progress=progress)
    assert found.names == ["held"]
    assert found.last_contact == pytest.approx([1.5])


def test_shares_at_other_thresholds():
    found = episode({(PALM, HANDLE): range(7)})  # 0.4 of its travel untouched
    of_untouched = found.sensitivity["untouched"]
    assert {value: shares["flung"] for value, shares in of_untouched.items()} == {
        "0.1": 1.0, "0.25": 1.0, "0.5": 0.0,
    }  # fmt: skip
    assert found.sensitivity["gap"]["5"]["flung"] == 0.0
    assert set(found.sensitivity) == set(SENSITIVITY)


def test_figures_and_columns():
    whole, flung = episode(GRASP, ALL), episode({(PALM, HANDLE): range(7)})
    both = replace(
        whole,
        names=[*whole.names, *flung.names],
        last_contact=np.concatenate([whole.last_contact, flung.last_contact]),
        untouched=np.concatenate([whole.untouched, flung.untouched]),
        kept=np.concatenate([whole.kept, flung.kept]),
        lost=np.concatenate([whole.lost, flung.lost]),
    )
    figures = both.figures(CONTACTS)
    assert figures["shares"]["grasp"] == figures["shares"]["flung"] == 0.5
    # Wilson's interval of 1 of 2.
    assert figures["shares_ci95"]["grasp"] == pytest.approx([0.0945, 0.9055], abs=1e-3)
    assert figures["travel_untouched_mean"] == pytest.approx(0.2)
    assert figures["force_by_part"] == {"palm": 0.0, "thumb": 0.5, "first": 0.5}
    assert both.columns()["strategy"] == ["grasp", "flung"]
    assert episode({}, progress=OPENING / 10).columns() == {
        "strategy": ["untouched"], "progress_at_last_contact": [None], "travel_untouched": [None],
    }  # fmt: skip


@given(
    forces=arrays(np.float32, (3, 10, 3, 2), elements=st.floats(0, 2, width=32)),
    opposition=arrays(np.float32, (3, 10), elements=st.floats(-1, 1, width=32)),
    progress=arrays(np.float64, (3, 10), elements=st.floats(0, 2)),
)
def test_every_episode_has_one_strategy(forces, opposition, progress):
    found = told(CONTACTS, forces, opposition, progress, progress > 1.4)
    assert set(found.names) <= set(STRATEGIES)
    for shares in (found.figures(CONTACTS)["shares"], *found.sensitivity["grasp"].values()):
        assert sum(shares.values()) == pytest.approx(1.0)
    known = found.untouched[np.isfinite(found.untouched)]
    assert ((known >= 0) & (known <= 1 + 1e-9)).all()


def test_names_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="knob"):
        replace(CONTACTS, held=("knob",))
    with pytest.raises(ValueError, match="toe"):
        replace(CONTACTS, thumb="toe")
