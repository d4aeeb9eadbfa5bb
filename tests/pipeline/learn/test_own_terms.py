"""A term of the objective in a user's file: trained with, resumed, and never run unasked."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from pipeline.files.run_files import RunDirectoryError
from pipeline.learn.own_terms import own_terms
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from tests.pipeline.resuming import differences, everything, whole_and_halved
from tests.pipeline.toys import built, tiny_config

FILE = """
from dataclasses import dataclass

from losses import ActorTerm, TermValue


@dataclass(frozen=True)
class Centre(ActorTerm):
    at: float = 0.5
    weight: float = 3.0
    name: str = "centre"

    def __call__(self, seen):
        return TermValue((seen.policy.deterministic_sample - self.at).square().mean())


def far():
    return Centre(at=2.0)


def broken():
    raise KeyError("x")


def nothing():
    return None
"""


@pytest.fixture
def terms(tmp_path: Path) -> Path:
    file = tmp_path / "my_terms.py"
    file.write_text(FILE)
    return file


def test_a_run_learns_from_it_and_goes_on_as_if_it_had_not_been_stopped(
    tmp_path: Path, demos: Path, terms: Path, monkeypatch: pytest.MonkeyPatch
):
    """With a weight that halves in the first update, and stays there."""
    weight = "{kind: piecewise, init: null, milestones: [1], values: [2.0, 1.0]}"
    own = f"[{{term: {terms}:Centre, at: 0.25, weight: {weight}}}]"
    whole, halved = whole_and_halved(tmp_path, demos, f"loss.own_terms={own}")
    assert differences(everything(halved), everything(whole)) == []
    objective = whole.trainer.loss_module
    term = objective.composition["centre"]
    assert (term.at, term.weight_at(0), term.weight_at(1)) == (0.25, 2.0, 1.0)
    assert "loss_centre" in objective.out_keys
    monkeypatch.delenv("TRUST", raising=False)
    recipe = load_recipe(whole.run_dir)  # to be played, which imports none of it
    (entry,) = recipe.loss.own_terms
    assert isinstance(entry, dict)
    assert entry["at"] == 0.25
    load_policy(recipe, recipe.find_task(), whole.run_dir)
    with pytest.raises(RunDirectoryError, match=r"asks to import .*my_terms\.py.*loss\.own_terms="):
        load_recipe(whole.run_dir, training=True)
    typed = f"loss.own_terms={own}"
    assert load_recipe(whole.run_dir, [typed], training=True).loss == recipe.loss


def test_another_value_of_a_setting_gives_another_policy(tmp_path: Path, demos: Path, terms: Path):
    def trained(name: str, at: float) -> dict[str, torch.Tensor]:
        own = f"loss.own_terms=[{{term: {terms}:Centre, at: {at}}}]"
        run = built(tiny_config("bc_sac", tmp_path / name, demos, own))
        run.train()
        return run.actor.state_dict()

    first = trained("first", 0.2)
    assert differences(trained("again", 0.2), first) == []
    assert differences(trained("other", 0.3), first) != []


def test_it_may_be_made_by_a_function(terms: Path):
    (term,) = own_terms([f"{terms}:far"], updates=1)
    assert (term.name, term.at) == ("centre", 2.0)


def test_settings_are_the_terms_own_and_two_of_a_class_stand_side_by_side(terms: Path):
    both = [
        {"term": f"{terms}:Centre", "at": 0.1},
        {"term": f"{terms}:Centre", "name": "edge", "at": 1.0, "weight": 0.25},
    ]
    centre, edge = own_terms(both, updates=1)
    assert (centre.name, centre.at, centre.weight_at(7)) == ("centre", 0.1, 3.0)
    assert (edge.name, edge.at, edge.weight_at(7)) == ("edge", 1.0, 0.25)


def test_a_weight_may_move_over_the_whole_run(terms: Path):
    """Half-way between 2 and 1 after 20 of 40 updates."""
    entry = {"term": f"{terms}:Centre", "weight": {"kind": "linear", "init": 2.0, "final": 1.0}}
    (term,) = own_terms([entry], updates=40)
    assert [term.weight_at(n) for n in (0, 20, 40)] == [2.0, 1.5, 1.0]


def test_a_weight_that_is_no_schedule_is_refused_in_one_line(terms: Path):
    entry = {"term": f"{terms}:Centre", "weight": {"kind": "linear", "init": 2.0}}
    with pytest.raises(ValueError, match=r"has no such weight: .*takes exactly init, final"):
        own_terms([entry], updates=40)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("broken", r"it cannot be made \(KeyError: 'x'\)"),
        ("nothing", r"gives NoneType; expected a losses\.ActorTerm or CriticTerm"),
        ("absent", r"there is no 'absent'; found: .*Centre"),
    ],
)
def test_what_is_no_term_is_refused_in_one_line(name: str, message: str, terms: Path):
    with pytest.raises(ValueError, match=message) as refused:
        own_terms([f"{terms}:{name}"], updates=1)
    assert f"loss.own_terms={terms}:{name}" in str(refused.value)
    assert "\n" not in str(refused.value)
