"""What the terms of one update share: the batch, and network outputs that are computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from losses.batch import Batch
from losses.distributions import SquashedNormal
from losses.policy import Rows, draw, policy_distribution


class Networks(Protocol):
    """The networks of an objective, as its terms see them."""

    actor: ProbabilisticActor
    critic: nn.Module
    target_critic: nn.Module
    ensemble_size: int | None
    """Number of critics, if ``critic`` can run some of them alone; ``None`` if it cannot."""

    @property
    def alpha(self) -> Tensor:
        """The temperature ``[]``, detached."""


class CriticPass:
    """What the critics' terms of one update share, on the R rows for reinforcement.

    Args:
        networks: Of the objective.
        batch: ``[R]`` transitions.
    """

    def __init__(self, networks: Networks, batch: Batch) -> None:
        self.networks = networks
        self.batch = batch

    @cached_property
    def q(self) -> Tensor:
        """``[E, R, 1]``, the critics' values of the batch's actions, with gradients."""
        return self.networks.critic(self.batch.observation, self.batch.action)


@dataclass(frozen=True)
class Sample:
    """Actions drawn from the policy in the R states for reinforcement.

    Attributes:
        observation: ``[R, O]``.
        action: ``[R, A]``, reparametrised, so that gradients reach the policy.
        log_prob: ``[R]``, their log-densities in nats.
    """

    observation: Tensor
    action: Tensor
    log_prob: Tensor


@dataclass(frozen=True)
class DemonstratedRows:
    """D rows of the batch that include all demonstrations, and the policy in their states.

    Attributes:
        networks: Of the objective.
        policy: the policy's distribution in the D states.
        batch: ``[D]``; ``batch.is_demo`` says which of them are demonstrations.
    """

    networks: Networks
    policy: TanhNormal
    batch: Batch


class ActorPass:
    """What the actor's terms of one update share: one forward pass of the actor on a batch.

    Args:
        networks: Of the objective.
        batch: ``[B]`` transitions.
        rows: The R rows for reinforcement, ``None`` for all of them.
    """

    def __init__(self, networks: Networks, batch: Batch, rows: Rows | None = None) -> None:
        self.networks = networks
        self.batch = batch
        self.rows = rows
        self.policy: TanhNormal = policy_distribution(networks.actor, batch.observation)

    @cached_property
    def sample(self) -> Sample:
        """Actions in the R rows for reinforcement, drawn when a term first asks for them."""
        rows = slice(None) if self.rows is None else self.rows
        action, log_prob = draw(self.policy, rows)
        return Sample(self.batch.observation[rows], action, log_prob)

    @cached_property
    def demonstrations(self) -> DemonstratedRows:
        """The rows after those for reinforcement; all rows, if the batch is not sorted so."""
        if isinstance(self.rows, slice) and isinstance(self.policy, SquashedNormal):
            # After them are demonstrations alone, before them none.
            others = slice(self.rows.stop, None)
            return DemonstratedRows(self.networks, self.policy[others], self.batch[others])
        return DemonstratedRows(self.networks, self.policy, self.batch)
