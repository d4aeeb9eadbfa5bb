"""What a term of the objective is, and what the terms of one update come to.

A term is a frozen dataclass of its settings that can be called. Everything that is done with it
follows from what it says of itself here: it is summed and differentiated with the others, its
metrics are logged under its name, and its weight moves. A new one is a class in a file of its own
(CONTRIBUTING.md, "How to add a term").
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
    """What a term is on one batch.

    Attributes:
        loss: ``[]``, not times its weight.
        measured: detached tensors by name, whose means are logged.
    """

    loss: Tensor
    measured: Mapping[str, Tensor] = field(default_factory=dict)


class Term(ABC):
    """One term of the objective: settings, a name and a loss.

    Subclasses are frozen dataclasses. Where one has a ``__post_init__`` of its own, it calls this
    one's, which makes a number given as weight a constant schedule.
    """

    reads: ClassVar[tuple[NestedKey, ...]] = ()
    """The entries of the batch that it reads, named as in :class:`~losses.batch.BatchKeys`."""
    reinforces: ClassVar[bool] = False
    """Whether it is about the rows that reinforce, and so needs some and a temperature."""
    logs: ClassVar[tuple[str, ...]] = ()
    """What of :attr:`TermValue.measured` is logged at each update."""
    logs_after_step: ClassVar[tuple[str, ...]] = ()
    """What :meth:`after_step` gives."""
    returns: ClassVar[tuple[str, ...]] = ()
    """What of :attr:`TermValue.measured` only the objective's ``forward`` gives besides."""

    name: str
    """Of the term in its objective, which has each name once."""
    weight: Schedule | float | None = None
    """Of its loss in the sum; ``None`` is 1 at all times, with nothing to log."""

    def __post_init__(self) -> None:
        """Make a number given as weight a schedule."""
        if self.weight is not None and not callable(self.weight):
            object.__setattr__(self, "weight", ConstantWeight(float(self.weight)))

    def weight_at(self, updates: int) -> float:
        """The weight of the update that follows ``updates`` completed ones, without its rule."""
        return self.weight(updates) if callable(self.weight) else 1.0

    def resolved(self, actor: ProbabilisticActor) -> Self:
        """Itself with what was left open settled for ``actor``."""
        return self

    def after_step(self, networks: Networks) -> Mapping[str, Tensor]:
        """What is logged of the state that an update leaves behind, detached scalars."""
        return {}

    def constants(self) -> Mapping[str, float]:
        """Settings that stand beside the metrics, which would mean little without them."""
        return {}

    # ------------------------------------------------------------------------ names of metrics

    @property
    def loss_key(self) -> str:
        """Of its loss, times its weight, among an objective's ``out_keys``."""
        return f"loss_{self.name}"

    @property
    def metric(self) -> str:
        """Of its loss in the logs, not times its weight."""
        return self.loss_key if self.weight is None else self.name

    @property
    def weight_metric(self) -> str:
        """Of its weight."""
        return f"{self.name}_weight"

    @property
    def norm_metric(self) -> str:
        """Of its gradient's norm, not times its weight."""
        return f"grad_norm_{self.name}"

    @property
    def cosine_metric(self) -> str:
        """Of the cosine between its gradient and the reinforcement term's."""
        return f"grad_cosine_{self.name}"


class CriticTerm(Term):
    """A term that trains the critics, and nothing else."""

    reads: ClassVar[tuple[NestedKey, ...]] = ("observation", "action")

    tau: float | None = None
    """Share of the critics that one update of the target critics moves into them, in [0, 1].

    At most one term of an objective has one; without, the target critics stay as they are.
    """

    @abstractmethod
    def __call__(self, seen: CriticPass) -> TermValue:
        """Compute the loss on the rows that reinforce."""


class ActorTerm(Term):
    """A term that trains the actor, and nothing else; all of them see one forward pass of it."""

    reads: ClassVar[tuple[NestedKey, ...]] = ("observation",)

    rule: WeightRule | None = None
    """Sets the weight by the sizes of the gradients; ``None`` leaves it to :attr:`weight`."""

    @abstractmethod
    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss; one that the batch says nothing about needs no gradient."""

    def demonstration_error(self, seen: ActorPass) -> Tensor | None:
        """The mean error ``[]`` of all demonstrations alike; ``None`` where it imitates none."""
        return None


def weighted(value: TermValue, weight: Any) -> Tensor:
    """The loss ``[]`` times its weight, a number or ``[]``; ``None`` is 1."""
    return value.loss if weight is None else weight * value.loss


def total(values: Mapping[str, TermValue], weights: Mapping[str, Any]) -> Tensor:
    """What is minimised ``[]``: the sum of the losses, each times its entry of ``weights``."""
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
