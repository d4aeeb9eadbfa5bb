"""The settings of a weight: kinds of the registry, and what a configuration may hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from configs import compose
from losses import SCHEDULES, PiecewiseWeight
from pipeline.commands.settings import about
from pipeline.learn.weights import WeightSettings
from pipeline.recipe import Recipe
from pipeline.settings import SettingsError, checked


@dataclass(frozen=True)
class Steps:
    """Each weight, 1 / k, for ``period`` updates."""

    init: float
    period: int

    def __call__(self, updates: int) -> float:
        return self.init / (1 + updates // self.period)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch):
    """A kind more in the registry, with a setting that no other has."""
    monkeypatch.setitem(SCHEDULES, "steps", Steps)  # type: ignore[arg-type]


@pytest.mark.usefixtures("steps")
def test_a_schedule_of_the_registry_needs_nothing_else():
    recipe = compose("variant=bc_sac", "loss.bc_weight={kind: steps, init: 6, period: 2}")
    weight = recipe.loss.bc_weight
    assert weight.schedule(1) == Steps(init=6.0, period=2)
    assert WeightSettings.of(Steps(init=6.0, period=2)) == weight
    assert Recipe.of(recipe.plain(), "saved") == recipe
    assert recipe.changed(loss={"bc_weight": {"period": 3}}).loss.bc_weight.schedule(1)(3) == 3.0
    with pytest.raises(SettingsError, match=r"there is no key loss\.bc_weight\.perio"):
        recipe.changed(loss={"bc_weight": {"perio": 3}})
    constant = compose("variant=bc_sac", "loss.bc_weight.kwargs.period=2").loss.bc_weight
    told = r"^loss\.bc_weight\.kwargs\.period=2 is not read by .*kind=constant, which has init: "
    with pytest.raises(ValueError, match=told):
        constant.schedule(1)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("liner", r"kind='liner': must be 'constant', .*, 'piecewise' or path.py:NAME of your own "
                  r"\(did you mean linear\?\)$"),
        ("quadratic", r"kind='quadratic': must be 'constant', .* of your own$"),
        ("mine.py", r"kind='mine\.py': must be 'constant', "),
        (3, r"kind=3: must be a valid string$"),
    ],
)  # fmt: skip
def test_an_unknown_kind_is_refused_with_those_that_there_are(kind: Any, message: str):
    with pytest.raises(SettingsError, match=rf"^changed recipe: loss\.bc_weight\.{message}"):
        Recipe().changed(loss={"bc_weight": {"kind": kind}})


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"init": 1.0}, "must be keys that do not stand beside kwargs"),
        ({"x": {"y": 1}}, "must be finite numbers, strings, true, false, null or lists of these"),
        ({"x": float("nan")}, "must be finite numbers"),
        (3, "must be a valid dictionary"),
    ],
)
def test_further_settings_are_plain_values_of_other_names(kwargs: Any, message: str):
    given = {"kind": "mine.py:Mine", "kwargs": kwargs}
    with pytest.raises(SettingsError, match=rf"^here: kwargs=.*: {message}"):
        checked(WeightSettings, given, "here")


def test_a_kind_without_a_first_weight_is_given_none():
    of = checked(WeightSettings, {"kind": "piecewise", "milestones": [2], "values": [2, 1]}, "here")
    assert of.schedule(1) == PiecewiseWeight((2,), (2.0, 1.0))
    assert checked(WeightSettings, {"kind": "mine.py:Mine"}, "here").options == {}
    assert checked(WeightSettings, {}, "here").options == {"init": 0.0}


def test_the_reference_lists_the_kinds():
    (kind,) = about(["loss.bc_weight.kind"])
    assert kind.kind == "constant | exponential | linear | cosine | piecewise | path.py:NAME"
