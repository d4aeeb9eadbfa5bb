"""Terms of the objective that stand in a user's own file (``loss.own_terms``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from envs.library.functions import load_function
from envs.one_line import kind_and_text
from losses.terms import ActorTerm, CriticTerm, Term

KEY: Final = "loss.own_terms"


def own_terms(names: Sequence[str]) -> list[Term]:
    """Makes the terms that ``path.py:NAME`` name, in this order.

    ``NAME`` is a class, or a function, that can be called without arguments and gives a
    :class:`~losses.terms.ActorTerm` or :class:`~losses.terms.CriticTerm`. Importing the file runs
    its code.

    Raises:
        ValueError: There is no such file or name, it fails, or it gives something else.
    """
    return [_term(where) for where in names]


def _term(where: str) -> Term:
    make = load_function(KEY, where)
    try:
        term = make()
    # Whatever a user's class or function raises is told in one line.
    except Exception as error:
        raise ValueError(
            f"{KEY}={where}: it cannot be made without arguments ({kind_and_text(error)})"
        ) from error
    if not isinstance(term, ActorTerm | CriticTerm):
        raise ValueError(
            f"{KEY}={where} gives {type(term).__name__}; expected a losses.ActorTerm or CriticTerm"
        )
    return term
