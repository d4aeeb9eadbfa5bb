"""What the terms read of a batch is what they say, and what the documentation says."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import fields

import pytest
from tensordict import NestedKey, TensorDict
from torch import Tensor

from losses import (
    ActorPass,
    ActorTerm,
    CriticPass,
    CriticTerm,
    Imitation,
    Objective,
    QFilter,
    SelfImitation,
    SoftTD,
    SoftValue,
    Temperature,
)
from losses.batch import OPTIONAL, Batch, BatchKeys
from losses.terms import Term
from tests.losses.toys import Critic, make_actor, make_full_batch

SAC = (SoftTD(), SoftValue(), Temperature())


def of_ours(kind: type[Term]) -> set[type[Term]]:
    """Its subclasses in losses/."""
    direct = {one for one in kind.__subclasses__() if one.__module__.startswith("losses.")}
    return direct.union(*map(of_ours, direct))


KINDS = sorted(of_ours(CriticTerm) | of_ours(ActorTerm), key=lambda kind: kind.__name__)
"""All terms of a network; their settings have defaults."""


class Spied:
    """A batch that notes which entries are asked for, of all rows or of some."""

    def __init__(self, data: TensorDict, asked: set[NestedKey]) -> None:
        self.data, self.asked = data, asked

    def __getitem__(self, index: NestedKey | Tensor | slice) -> Tensor | Spied:
        if isinstance(index, str | tuple):
            return self.get(index)
        return Spied(self.data[index], self.asked)

    def get(self, key: NestedKey, *default: None) -> Tensor:
        self.asked.add(key)
        return self.data.get(key, *default)


def objective(*terms: Term) -> Objective:
    return Objective(make_actor(), [Critic(), Critic()], terms)


@pytest.mark.parametrize("term", [kind() for kind in KINDS] + [Imitation(row_weights=[QFilter()])])
def test_a_term_reads_what_it_says(term: CriticTerm | ActorTerm) -> None:
    """Without an action to imitate instead, so that the executed one is read in its place."""
    loss, asked = objective(*SAC), set[NestedKey]()
    batch = Batch(Spied(make_full_batch(6, 2).exclude("imitated_action"), asked), BatchKeys())
    if isinstance(term, CriticTerm):
        term(CriticPass(loss, batch))
    else:
        term(ActorPass(loss, batch))
    assert asked == set(term.reads)


OBJECTIVES = {
    "SAC": SAC,
    "BC": (Imitation(),),
    "all": (*SAC, Imitation(), SelfImitation()),
}


@pytest.mark.parametrize("terms", OBJECTIVES.values(), ids=OBJECTIVES)
def test_in_keys_are_sufficient_and_each_is_needed(terms: Sequence[Term]) -> None:
    loss = objective(*terms)
    batch = make_full_batch(4, 2).select(*loss.in_keys)
    loss(batch)
    for key in loss.in_keys:
        with pytest.raises(KeyError):
            loss(batch.exclude(key))


def documented() -> dict[NestedKey, tuple[str, set[str]]]:
    """Meaning and readers by the names in the table of BatchKeys."""
    lines = inspect.cleandoc(BatchKeys.__doc__ or "").splitlines()
    rules = [number for number, line in enumerate(lines) if line.startswith("===")]
    edges = [index for index, mark in enumerate(lines[rules[0]] + " ") if mark == " "]
    found: dict[NestedKey, tuple[str, set[str]]] = {}
    for line in lines[rules[1] + 1 : rules[2]]:
        cells = [line[start:end].strip() for start, end in zip([0, *edges], edges, strict=False)]
        name, meaning, readers = cells[0], cells[2], cells[3]
        parts = name.strip("()").split(", ")
        found[parts[0] if len(parts) == 1 else tuple(parts)] = meaning, set(readers.split(", "))
    return found


def test_the_documented_table_is_what_the_terms_read() -> None:
    assert {SoftTD, SoftValue, Imitation, SelfImitation} <= set(KINDS)
    table = documented()
    names = {name[-1] if isinstance(name, tuple) else name for name in table}
    assert names == {field.name for field in fields(BatchKeys)}
    assert {name for name, (meaning, _) in table.items() if "optional" in meaning} == set(OPTIONAL)
    for name, (_, readers) in table.items():
        of_terms = {kind.__name__ for kind in KINDS if name in kind.reads}
        if readers == {"all terms of critics and actor"}:
            assert len(of_terms) == len(KINDS)
        else:
            assert readers - {"Objective"} == of_terms, name


def test_the_objective_reads_the_marks_to_choose_rows() -> None:
    loss, asked = objective(*SAC), set[NestedKey]()
    loss.actor_terms(Spied(make_full_batch(6, 2), asked))  # type: ignore[arg-type]
    assert asked == {"observation", "is_demo"}
