"""A schedule in a user's file: weights by hand, resumed, and never run unasked."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from configs import compose
from envs.library import functions
from pipeline.build import build_run
from pipeline.files.run_files import RunDirectoryError
from pipeline.learn.own_terms import own_terms
from pipeline.learn.weights import WeightSettings
from pipeline.policy import load_policy
from pipeline.recipe import Recipe
from pipeline.run_dir import create_run_dir, load_recipe
from pipeline.settings import checked
from tests.pipeline.resuming import differences, everything, whole_and_halved

FILE = """
from dataclasses import dataclass

from losses import ActorTerm, TermValue


@dataclass(frozen=True)
class Sawtooth:
    init: float
    period: int

    def __call__(self, updates):
        return self.init * (1 - updates % self.period / self.period)


@dataclass(frozen=True)
class Until:
    duration: int

    def __call__(self, updates):
        return int(updates < self.duration)


def square(init, power=2):
    return lambda updates: init / (1 + updates) ** power


class Counting:
    calls = 0

    def __call__(self, updates):
        self.calls += 1
        return self.calls


def given(what):
    values = {"text": "1", "true": True, "nan": float("nan"), "negative": -1.0, "fails": {}["x"]
              if what == "key" else None}
    return lambda updates: values[what]


def failing():
    return lambda updates: 1 / updates


def number():
    return 3.0


@dataclass(frozen=True)
class Centre(ActorTerm):
    weight: float = 3.0
    name: str = "centre"

    def __call__(self, seen):
        return TermValue(seen.policy.deterministic_sample.square().mean())
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my_schedules.py"
    path.write_text(FILE)
    return path


def weights(given: dict[str, Any], at: list[int], updates: int = 1) -> list[float]:
    schedule = checked(WeightSettings, given, "here").schedule(updates)
    return [schedule(n) for n in at]


def test_weights_by_hand(file: Path):
    """A tooth of four updates from 2 down; one over the whole run; and 8 over n + 1 squared."""
    tooth = {"kind": f"{file}:Sawtooth", "init": 2.0, "period": 4}
    assert weights(tooth, [0, 1, 2, 3, 4, 9]) == [2.0, 1.5, 1.0, 0.5, 2.0, 1.5]
    until = {"kind": f"{file}:Until"}
    assert weights(until, [0, 6, 7], updates=7) == [1.0, 1.0, 0.0]
    assert weights({**until, "duration": 2}, [1, 2], updates=7) == [1.0, 0.0]
    square = {"kind": f"{file}:square", "init": 8.0}
    assert weights(square, [0, 1, 3]) == [8.0, 2.0, 0.5]
    assert weights({**square, "power": 3}, [1]) == [1.0]


def test_the_weight_of_a_term_of_ones_own_may_be_one(file: Path):
    weight = {"kind": f"{file}:Sawtooth", "init": 2.0, "period": 4}
    (term,) = own_terms([{"term": f"{file}:Centre", "weight": weight}], updates=1)
    assert [term.weight_at(n) for n in (0, 1, 4)] == [2.0, 1.5, 2.0]
    wrong = {"term": f"{file}:Centre", "weight": {**weight, "height": 1}}
    told = r"^loss\.own_terms=.* has no such weight: weight=.*has no setting 'height'"
    with pytest.raises(ValueError, match=told) as refused:
        own_terms([wrong], updates=1)
    assert "\n" not in str(refused.value)


def test_a_run_goes_on_with_it_as_if_it_had_not_been_stopped(
    tmp_path: Path, demos: Path, file: Path, monkeypatch: pytest.MonkeyPatch
):
    """The parent's weight decays, which this one does not; a term of its own has one too."""
    of_term = f"{{kind: {file}:Sawtooth, init: 0.5, period: 3}}"
    typed = [
        f"loss.bc_weight={{kind: {file}:Sawtooth, decay: null, period: 5}}",
        f"loss.own_terms=[{{term: {file}:Centre, weight: {of_term}}}]",
    ]
    whole, halved = whole_and_halved(tmp_path, demos, *typed)
    assert differences(everything(halved), everything(whole)) == []
    loss = whole.trainer.loss_module
    assert loss.updates > 10
    loss.updates = 11  # 1 of 5 into the third tooth, 2 of 3 into the fourth
    assert loss.current_bc_weight == 0.8
    assert loss.weight_of("centre") == pytest.approx(0.5 / 3)

    monkeypatch.delenv("TRUST", raising=False)
    with monkeypatch.context() as within:  # to be played, which imports none of it
        within.setattr(functions, "import_file", lambda *_: pytest.fail("imported"))
        recipe = load_recipe(whole.run_dir)
        load_policy(recipe, recipe.find_task(), whole.run_dir)
    assert recipe.loss.bc_weight.kwargs == {"period": 5}
    assert load_recipe(whole.run_dir, typed, training=True).loss == recipe.loss


def test_a_strangers_schedule_is_imported_when_it_is_named_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Other keys of the weight do not name it."""
    monkeypatch.delenv("TRUST", raising=False)
    run = tmp_path / "run"
    kind = "theirs.py:Sawtooth"
    create_run_dir(run, Recipe().changed(loss={"bc_weight": {"kind": kind, "period": 3}}))
    load_recipe(run)
    asked = r"asks to import 'theirs\.py:Sawtooth' \(loss\.bc_weight\.kind=theirs\.py:Sawtooth\)"
    for typed in ([], ["loss.bc_weight.init=0"], ["loss.bc_weight={init: 0, period: 3}"]):
        with pytest.raises(RunDirectoryError, match=asked) as refused:
            load_recipe(run, typed, training=True)
    (named,) = re.findall(r"ARGS=\"(.*)\"", str(refused.value))
    for typed in (
        named,
        f"loss.bc_weight={{kind: {kind}}}",
        f"loss={{bc_weight: {{kind: {kind}}}}}",
    ):
        assert load_recipe(run, [typed], training=True).loss.bc_weight.own_file == kind
    monkeypatch.setenv("TRUST", "1")
    load_recipe(run, training=True)


def test_the_schedule_of_a_strangers_term_is_named_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("TRUST", raising=False)
    entry = {"term": "a.py:A", "weight": {"kind": "b.py:B"}}
    create_run_dir(tmp_path / "run", Recipe().changed(loss={"own_terms": [entry]}))
    with pytest.raises(RunDirectoryError, match=r"asks to import 'a\.py:A, b\.py:B'"):
        load_recipe(tmp_path / "run", training=True)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("absent", {}, "there is no 'absent'; found: "),
        ("Sawtooth", {"init": 1.0}, "cannot be called with these .*'period'"),
        ("square", {"init": 1.0, "x": 1}, "has no setting 'x'; it has init, power, and what is nu"),
        ("number", {}, "gives float; expected a callable: number of updates -> weight"),
        ("given", {"what": "key"}, r"it cannot be made \(KeyError: 'x'\)"),
        ("given", {"what": "text"}, "gave '1' after 0 updates; expected a finite number >= 0"),
        ("given", {"what": "true"}, "gave True after 0 updates"),
        ("given", {"what": "nan"}, "gave nan after 0 updates"),
        ("given", {"what": "negative"}, "gave -1.0 after 0 updates"),
        ("failing", {}, r"failed after 0 updates \(ZeroDivisionError: division by zero\)"),
        (
            "Counting",
            {},
            "gives 1 and then 2 after 0 updates; a weight may depend on the number of",
        ),
    ],
)
def test_what_is_no_schedule_is_refused_in_one_line(
    name: str, settings: dict[str, Any], message: str, file: Path
):
    with pytest.raises(ValueError, match=message) as refused:
        weights({"kind": f"{file}:{name}", **settings}, [])
    assert str(refused.value).startswith("loss.bc_weight")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("loss.bc_weight={kind: FILE:Until}", r"Until has no setting 'init'; it has duration, and"),
        ("loss.bc_weight.decay=0.9", r"loss\.bc_weight\.decay=0\.9 is not read by .*kind=constant"),
    ],
)
def test_a_run_refuses_it_before_it_reads_demonstrations(
    typed: str, message: str, tmp_path: Path, file: Path
):
    typed = typed.replace("FILE", str(file))
    recipe = compose("variant=bc_sac", "preset=smoke", "demos.source='nowhere.h5'", typed)
    with pytest.raises(ValueError, match=message):
        build_run(recipe, tmp_path / "run")
    assert not (tmp_path / "run").exists()
