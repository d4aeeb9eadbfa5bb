"""How far a run goes, with an environment and without one."""

from __future__ import annotations

from operator import attrgetter

import pytest

from pipeline.recipe import Recipe


@pytest.mark.parametrize(("offline", "total"), [(False, 30), (True, 70)])
def test_the_budget_is_the_setting_that_it_names(offline: bool, total: int):
    recipe = Recipe().changed(offline=offline, collector={"total_frames": 30}, bc={"updates": 70})
    assert recipe.budget.total == attrgetter(recipe.budget.key)(recipe) == total


@pytest.mark.parametrize(("offline", "frames"), [(False, 12), (True, 0)])
def test_updates_of_cloning_are_no_frames(offline: bool, frames: int):
    budget = Recipe().changed(offline=offline).budget
    assert budget.frames(12) == frames
    assert (budget.unit == "frames") is not offline
