"""What the terms of one update share: a batch, and what the networks make of it once."""

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
    """What learns, and what is needed to let it."""

    actor: ProbabilisticActor
    critic: nn.Module
    target_critic: nn.Module
    ensemble_size: int | None
    """Critics of which some can be run alone; ``None`` where only all can."""

    @property
    def alpha(self) -> Tensor:
        """The temperature ``[]``, detached."""


class CriticPass:
    """The critics' terms of one update, on the R rows that reinforce.

    Args:
        networks: Of the objective.
        batch: ``[R]`` transitions.
    """

    def __init__(self, networks: Networks, batch: Batch) -> None:
        self.networks = networks
        self.batch = batch

    @cached_property
    def q(self) -> Tensor:
        """``[E, R, 1]``, the critics' values of the batch's own actions, with their gradients."""
        return self.networks.critic(self.batch.observation, self.batch.action)


@dataclass(frozen=True)
class Sample:
    """Actions of the policy in the states that reinforce.

    Attributes:
        observation: ``[R, O]``.
        action: ``[R, A]``, reparametrised.
        log_prob: ``[R]``, their log-densities in nats.
    """

    observation: Tensor
    action: Tensor
    log_prob: Tensor


@dataclass(frozen=True)
class Demonstrations:
    """Rows among which the demonstrations are, and the policy in them.

    Attributes:
        networks: Of the objective.
        policy: the distribution of D rows.
        batch: ``[D]``; ``batch.is_demo`` says which of them are demonstrations.
    """

    networks: Networks
    policy: TanhNormal
    batch: Batch


class ActorPass:
    """One forward pass of the actor on a batch, which all of the actor's terms share.

    Args:
        networks: Of the objective.
        batch: ``[B]`` transitions.
        rows: The R rows that reinforce, ``None`` for all of them.
    """

    def __init__(self, networks: Networks, batch: Batch, rows: Rows | None = None) -> None:
        self.networks = networks
        self.batch = batch
        self.rows = rows
        self.policy: TanhNormal = policy_distribution(networks.actor, batch.observation)

    @cached_property
    def sample(self) -> Sample:
        """Drawn when a term first asks; demonstrations draw no actions."""
        rows = slice(None) if self.rows is None else self.rows
        action, log_prob = draw(self.policy, rows)
        return Sample(self.batch.observation[rows], action, log_prob)

    @cached_property
    def demonstrations(self) -> Demonstrations:
        """The rows after those that reinforce, or all where they are not that well sorted."""
        if isinstance(self.rows, slice) and isinstance(self.policy, SquashedNormal):
            # After them are demonstrations alone, before them none.
            others = slice(self.rows.stop, None)
            return Demonstrations(self.networks, self.policy[others], self.batch[others])
        return Demonstrations(self.networks, self.policy, self.batch)
