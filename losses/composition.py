"""The terms of one objective: checked against each other, with the names of what they log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from torchrl.modules import ProbabilisticActor

from losses.temperature import Temperature
from losses.terms import ActorTerm, CriticTerm, Term

AnyTerm = TypeVar("AnyTerm", bound=Term)


class Composition:
    """Terms by name, checked against each other.

    Args:
        terms: Of one objective, in the order in which they are computed and summed.

    Raises:
        ValueError: if two terms share a name or a metric, a term with ``reinforces`` has no
            temperature, a temperature learns or a term has a rule but the actor has no (other)
            reinforcement term, whose actions and gradient these need, or two terms are a
            temperature or have a ``tau``.
        TypeError: for a term that is neither a critic's, nor an actor's, nor a temperature.
    """

    def __init__(self, terms: Sequence[Term]) -> None:
        self.terms = tuple(terms)
        self.of_critic = [term for term in self.terms if isinstance(term, CriticTerm)]
        self.of_actor = [term for term in self.terms if isinstance(term, ActorTerm)]
        temperatures = [term for term in self.terms if isinstance(term, Temperature)]
        _require_kinds(self.terms, [*self.of_critic, *self.of_actor, *temperatures])
        self._by_name = {term.name: term for term in self.terms}
        self.temperature = _only("a temperature", temperatures)
        moving = _only("tau", [term for term in self.of_critic if term.tau is not None])
        self.tau = None if moving is None else moving.tau
        self.reference = next((term for term in self.of_actor if term.reinforces), None)
        """The actor's reinforcement term, with whose gradient those of the others are compared."""
        self._require_harmony()

    def __getitem__(self, name: str) -> Term:
        """The term of this name."""
        if name not in self._by_name:
            known = ", ".join(self._by_name)
            raise ValueError(f"there is no term {name!r} in the objective; it has {known}")
        return self._by_name[name]

    def resolved(self, actor: ProbabilisticActor) -> Composition:
        """Return the composition of the terms resolved for ``actor`` (``Term.resolved``)."""
        return Composition([term.resolved(actor) for term in self.terms])

    def with_settings(self, name: str, /, **settings: Any) -> Composition:
        """Return the composition with other settings of the term ``name``, which keeps its name."""
        term = self[name]
        if settings.get("name", name) != name:
            raise ValueError(f"the term {name!r} keeps its name, by which its metrics are known")
        changed = replace(term, **settings)  # type: ignore[type-var]  # terms are dataclasses
        return Composition([changed if term.name == name else term for term in self.terms])

    # ---------------------------------------------------------------------------------- metrics

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of what an update logs: losses, weights, measurements and actor gradients."""
        return (*self._losses(), *sorted(self._measured()), *self._gradients())

    @property
    def out_keys(self) -> list[str]:
        """Names of what the objective's ``forward`` returns."""
        of_weighted = (k for t in self.terms if t.weight is not None for k in _own(t))
        losses = [term.loss_key for term in self._minimised()]
        measured = [*self._measured(), *(k for t in self.terms for k in t.returns)]
        return [*losses, *sorted({*of_weighted, *measured})]

    def _losses(self) -> list[str]:
        return [term.metric for term in self._minimised()] + [
            term.weight_metric for term in self.terms if term.weight is not None
        ]

    def _minimised(self) -> list[Term]:
        """The terms that have a loss: not a temperature that no action of the policy moves."""
        idle = self.temperature if self.reference is None else None
        return [term for term in self.terms if term is not idle]

    def _measured(self) -> list[str]:
        return [name for term in self.terms for name in (*term.logs, *term.logs_after_step)]

    def _gradients(self) -> list[str]:
        if self.reference is None:
            return []
        names = [self.reference.norm_metric]
        for term in self.of_actor:
            if term is not self.reference:
                names += [term.norm_metric, term.cosine_metric]
        return names

    def _require_harmony(self) -> None:
        for kind, names in (
            ("name", [term.name for term in self.terms]),
            ("metric", list(self.metrics)),
        ):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise ValueError(
                    f"two terms have the {kind} {twice[0]!r}: give one of them another name="
                )
        for term in self.terms:
            if term.reinforces and self.temperature is None:
                raise ValueError(
                    f"the term {term.name!r} weighs entropy by a temperature, which the objective "
                    "does not have: add Temperature(), with learn=False for a fixed one"
                )
        if self.reference is None and self.temperature is not None and self.temperature.learn:
            raise ValueError(
                f"the term {self.temperature.name!r} learns from actions that a reinforcement term "
                "of the actor draws, which the objective does not have: add SoftValue(), or "
                "Temperature(learn=False)"
            )
        for term in self.of_actor:
            if term.rule is not None and (self.reference is None or term is self.reference):
                raise ValueError(
                    f"the rule {term.rule} of the term {term.name!r} is relative to a "
                    "reinforcement term of the actor, which must be another one: add SoftValue(), "
                    "or give rule=None"
                )


def _own(term: Term) -> tuple[str, str]:
    return term.metric, term.weight_metric


def _require_kinds(terms: Sequence[Term], known: Sequence[Term]) -> None:
    for term in terms:
        if not any(term is one for one in known):
            raise TypeError(
                f"a term is a CriticTerm, an ActorTerm or a Temperature, got {term!r}: derive its "
                "class from one of these"
            )


def _only(what: str, terms: Sequence[AnyTerm]) -> AnyTerm | None:
    """The one of ``terms``, or ``None``."""
    if len(terms) > 1:
        names = ", ".join(repr(term.name) for term in terms)
        raise ValueError(f"an objective has at most one term with {what}, got {names}")
    return terms[0] if terms else None
