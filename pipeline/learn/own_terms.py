"""Terms of the objective that stand in a user's own file (``loss.own_terms``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

from pydantic import AfterValidator

from losses.terms import ActorTerm, CriticTerm, Term
from pipeline.learn.weights import WeightSettings
from pipeline.own_parts import Entry, OwnParts

TERMS: Final = OwnParts("loss.own_terms", "term", sections={"weight": WeightSettings})
OwnTerm = Annotated[Entry, AfterValidator(TERMS.checked)]


def own_terms(entries: Sequence[Entry], updates: int) -> list[Term]:
    """Makes the terms of the entries, in this order.

    What an entry names is a class, or a function, that takes the entry's settings as keyword
    arguments and gives a :class:`~losses.terms.ActorTerm` or :class:`~losses.terms.CriticTerm`. A
    ``weight`` with the keys of ``loss.bc_weight`` is given as a schedule. Importing the file runs
    its code.

    Args:
        entries: Of the configuration.
        updates: Of the actor in the whole run, over which a weight without ``duration`` moves.

    Raises:
        ValueError: There is no such file, name or setting, it fails, or it gives something else.
    """
    return [_term(entry, updates) for entry in entries]


def _term(entry: Entry, updates: int) -> Term:
    weight = TERMS.options(entry).get("weight")
    scheduled = {}
    if isinstance(weight, WeightSettings):
        try:
            scheduled["weight"] = weight.schedule(updates, "weight")
        except ValueError as error:
            raise TERMS.refused(entry, f"has no such weight: {error}") from error
    term = TERMS.make(entry, **scheduled)
    if not isinstance(term, ActorTerm | CriticTerm):
        given = type(term).__name__
        raise TERMS.refused(entry, f"gives {given}; expected a losses.ActorTerm or CriticTerm")
    return term
