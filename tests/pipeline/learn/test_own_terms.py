"""A term of the objective in a user's file: trained with, resumed, and never run unasked."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.learn.own_terms import own_terms
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from tests.pipeline.resuming import differences, everything, whole_and_halved

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
    own = f"loss.own_terms=['{terms}:Centre']"
    whole, halved = whole_and_halved(tmp_path, demos, own)
    assert differences(everything(halved), everything(whole)) == []
    objective = whole.trainer.loss_module
    assert objective.composition["centre"].at == 0.5
    assert "loss_centre" in objective.out_keys
    monkeypatch.delenv("TRUST", raising=False)
    recipe = load_recipe(whole.run_dir)  # to be played, which imports none of it
    load_policy(recipe, recipe.find_task(), whole.run_dir)
    with pytest.raises(RunDirectoryError, match=r"asks to import .*my_terms\.py.*loss\.own_terms="):
        load_recipe(whole.run_dir, training=True)
    typed = f"loss.own_terms=[{terms}:Centre]"
    assert load_recipe(whole.run_dir, [typed], training=True).loss == recipe.loss


def test_it_may_be_made_by_a_function(terms: Path):
    (term,) = own_terms([f"{terms}:far"])
    assert (term.name, term.at) == ("centre", 2.0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("broken", r"cannot be made without arguments \(KeyError: 'x'\)"),
        ("nothing", r"gives NoneType; expected a losses\.ActorTerm or CriticTerm"),
        ("absent", r"there is no 'absent'; found: .*Centre"),
    ],
)
def test_what_is_no_term_is_refused_in_one_line(name: str, message: str, terms: Path):
    with pytest.raises(ValueError, match=message) as refused:
        own_terms([f"{terms}:{name}"])
    assert f"loss.own_terms={terms}:{name}" in str(refused.value)
    assert "\n" not in str(refused.value)
