"""What a term of the objective is, and the values of the terms on one batch.

A term is a frozen dataclass that holds its settings and returns its loss when it is called.
Nothing else needs to know the class of a term: by the attributes declared here it is summed and
differentiated together with the others, its metrics are logged under its name, and its weight
follows its schedule. A new term is a class in a file of its own (CONTRIBUTING.md, "a term of the
objective").
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from tensordict import NestedKey
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from losses.passes import ActorPass, CriticPass, Networks
from losses.rules import WeightRule
from losses.schedules import ConstantWeight, Schedule


@dataclass(frozen=True)
class TermValue:
    """Loss and measurements of a term on one batch.

    Attributes:
        loss: ``[]``, before it is multiplied by the term's weight.
        measured: detached tensors by name, of which means are logged.
    """

    loss: Tensor
    measured: Mapping[str, Tensor] = field(default_factory=dict)


class Term(ABC):
    """One term of the objective: settings, a name and a loss.

    Subclasses are frozen dataclasses. A ``__post_init__`` of a subclass must call this class's,
    which turns a number given as weight into a constant schedule.
    """

    reads: ClassVar[tuple[NestedKey, ...]] = ()
    """Entries of the batch that the term reads, named as in :class:`~losses.batch.BatchKeys`."""
    reinforces: ClassVar[bool] = False
    """Whether the term is reinforcement: it needs a temperature, and rows to reinforce on."""
    logs: ClassVar[tuple[str, ...]] = ()
    """Names in :attr:`TermValue.measured` whose means are logged at each update."""
    logs_after_step: ClassVar[tuple[str, ...]] = ()
    """Names of the scalars that :meth:`after_step` returns."""
    returns: ClassVar[tuple[str, ...]] = ()
    """Names in :attr:`TermValue.measured` that the objective's ``forward`` returns, not logged."""

    name: str
    """Name of the term, unique in its objective."""
    weight: Schedule | float | None = None
    """Factor on the loss in the objective; ``None`` is always 1, and no weight is logged."""

    def __post_init__(self) -> None:
        """Turn a number given as weight into a schedule."""
        if self.weight is not None and not callable(self.weight):
            object.__setattr__(self, "weight", ConstantWeight(float(self.weight)))

    def weight_at(self, updates: int) -> float:
        """Return the schedule's weight for the update that follows ``updates`` completed ones."""
        return self.weight(updates) if callable(self.weight) else 1.0

    def resolved(self, actor: ProbabilisticActor) -> Self:
        """Return the term with settings that depend on ``actor`` filled in."""
        return self

    def after_step(self, networks: Networks) -> Mapping[str, Tensor]:
        """Return detached scalars ``[]`` to log about the networks after an update."""
        return {}

    def constants(self) -> Mapping[str, float]:
        """Return settings to log beside the metrics, which are hard to judge without them."""
        return {}

    # ------------------------------------------------------------------------ names of metrics

    @property
    def loss_key(self) -> str:
        """Key of the loss, times its weight, among the objective's ``out_keys``."""
        return f"loss_{self.name}"

    @property
    def metric(self) -> str:
        """Name in the logs of the loss, before it is multiplied by its weight."""
        return self.loss_key if self.weight is None else self.name

    @property
    def weight_metric(self) -> str:
        """Name in the logs of the weight."""
        return f"{self.name}_weight"

    @property
    def norm_metric(self) -> str:
        """Name in the logs of the norm of the loss's gradient, without the weight."""
        return f"grad_norm_{self.name}"

    @property
    def cosine_metric(self) -> str:
        """Name in the logs of the cosine between its gradient and the reinforcement term's."""
        return f"grad_cosine_{self.name}"


class CriticTerm(Term):
    """A term that trains the critics and no other network."""

    reads: ClassVar[tuple[NestedKey, ...]] = ("observation", "action")

    tau: float | None = None
    """Step in [0, 1] of the target critics towards the critics at each of their updates.

    At most one term of an objective has one. If none has, the target critics never change.
    """

    @abstractmethod
    def __call__(self, seen: CriticPass) -> TermValue:
        """Compute the loss on the R rows for reinforcement."""


class ActorTerm(Term):
    """A term that trains the actor and no other network; all share one forward pass of it."""

    reads: ClassVar[tuple[NestedKey, ...]] = ("observation",)

    rule: WeightRule | None = None
    """Computes the weight in use from the gradients' norms; ``None`` uses :attr:`weight` itself."""

    @abstractmethod
    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss.

        Where the batch lacks what the term is about, it may be a constant without gradient.
        """

    def demonstration_error(self, seen: ActorPass) -> Tensor | None:
        """Return the mean error ``[]`` over all demonstrations, each with the same weight.

        ``None`` if the term does not imitate demonstrations.
        """
        return None


def weighted(value: TermValue, weight: Any) -> Tensor:
    """Return the loss ``[]`` times ``weight``, a number or a tensor ``[]``; ``None`` is 1."""
    return value.loss if weight is None else weight * value.loss


def total(values: Mapping[str, TermValue], weights: Mapping[str, Any]) -> Tensor:
    """Return the sum ``[]`` of the losses, each times its entry of ``weights``, 1 without one."""
    first, *others = [weighted(value, weights.get(name)) for name, value in values.items()]
    return sum(others, start=first)


@dataclass(frozen=True)
class CriticTerms:
    """The terms of the critics' objective on one batch.

    Attributes:
        values: the terms by name.
    """

    values: Mapping[str, TermValue]


@dataclass(frozen=True)
class ActorTerms:
    """The terms of the actor's objective, from one forward pass of the actor.

    They are not summed, so that their gradients can be taken, logged and balanced one by one. The
    graph of the forward pass is shared, so all but the last of several backward passes need
    ``retain_graph=True``.

    Attributes:
        values: the terms by name.
        log_prob: ``[R]``, log-density in nats of the sampled actions, detached; ``None`` where no
            term reinforces.
    """

    values: Mapping[str, TermValue]
    log_prob: Tensor | None
