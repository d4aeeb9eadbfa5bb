"""Policies that make more of what an actor says, whatever noise it acts with."""

from __future__ import annotations

from abc import abstractmethod
from typing import Self

import torch
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import ProbabilisticActor

from losses import functional as F
from losses.proposal import Proposal
from pipeline.act.chosen_starts import IS_INIT
from pipeline.settings import STRICT, Positive

ACTION = "action"


class PolicyWrapper(TensorDictModuleBase):
    """A policy around a core: an actor, or another one that acts with an actor's weights.

    Args:
        core: Writes an ``action`` for an ``observation [N, O]``.
    """

    def __init__(self, core: TensorDictModuleBase) -> None:
        super().__init__()
        self.core = core
        self.in_keys = list(core.in_keys)
        self.out_keys = [ACTION]

    @abstractmethod
    def through(self, core: TensorDictModuleBase) -> Self:
        """The same around another core."""


def unwrapped(policy: TensorDictModuleBase) -> TensorDictModuleBase:
    """The innermost policy."""
    return unwrapped(policy.core) if isinstance(policy, PolicyWrapper) else policy


def through(policy: TensorDictModuleBase, core: TensorDictModuleBase) -> TensorDictModuleBase:
    """What ``policy`` is around its core, around another one."""
    if not isinstance(policy, PolicyWrapper):
        return core
    return policy.through(through(policy.core, core))


@settings(frozen=True, kw_only=True, config=STRICT)
class ProposalSettings:
    """Where the BC model proposes its action beside the policy's, and the critics choose (IBRL)."""

    acting: bool = False
    bootstrap: bool = False  # in the critics' targets
    beta: Positive | None = None  # drawn in proportion to exp(beta Q); None = the better one

    @property
    def used(self) -> bool:
        """Whether anything is proposed."""
        return self.acting or self.bootstrap

    def of(self, imitator: ProbabilisticActor) -> Proposal:
        """What ``imitator`` proposes, which learns no more."""
        return Proposal(imitator.requires_grad_(False).eval(), self.beta)


class ProposingPolicy(PolicyWrapper):
    """Acts with the better of two actions: the core's and that of a policy that imitates.

    Where noise is turned off, the better one is taken whatever ``proposal.beta``.

    Args:
        core: Of the policy that learns.
        proposal: The other policy, and how it is chosen between them.
        critic: ``(observation, action) -> [E, N, 1]``; the least of these values counts.
    """

    def __init__(self, core: TensorDictModuleBase, proposal: Proposal, critic: nn.Module) -> None:
        super().__init__(core)
        self.proposal = proposal
        self.imitator = proposal.actor
        self.critic = critic

    def through(self, core: TensorDictModuleBase) -> Self:
        """The same around another core."""
        return type(self)(core, self.proposal, self.critic)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action [N, A] for the observation [N, O]."""
        acted: TensorDictBase = self.core(tensordict)
        greedy = exploration_type() == ExplorationType.DETERMINISTIC
        observation, own = acted["observation"], acted[ACTION]
        action, _ = self.proposal(observation, own, self._value, greedy=greedy)
        return acted.set(ACTION, action)

    def _value(self, observation: Tensor, action: Tensor) -> Tensor:
        return F.subset_minimum(self.critic(observation, action))


CHUNK = "chunk"
"""[N, k, A], the actions that are left of the present chunk, the next one first."""
LEFT = "chunk_left"
"""[N, 1] int64, how many these are."""


class ChunkedPolicy(PolicyWrapper):
    """Executes the actions that a core gives at once, one a step, without looking (Q-chunking).

    Source: arXiv:2507.07969, section 4. What is left of a chunk travels in the tensordict, under
    ``chunk`` and ``chunk_left``: without them, or where ``is_init`` tells that an episode begins, a
    new one is begun.

    Args:
        core: Gives k actions at once, ``[N, k A]``, the first one first.
        length: k.
    """

    def __init__(self, core: TensorDictModuleBase, length: int) -> None:
        super().__init__(core)
        self.length = length

    def through(self, core: TensorDictModuleBase) -> Self:
        """The same around another core."""
        return type(self)(core, self.length)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action [N, A] for the observation [N, O], and what is left of its chunk."""
        acted: TensorDictBase = self.core(tensordict)
        chunk = acted[ACTION].unflatten(-1, (self.length, -1))
        left = torch.full((len(chunk), 1), self.length, device=chunk.device)
        before = acted.get(LEFT, None)
        if before is not None:
            goes_on = (before > 0) & ~acted.get(IS_INIT, torch.zeros_like(before)).bool()
            chunk = torch.where(goes_on.unsqueeze(-1), acted[CHUNK], chunk)
            left = torch.where(goes_on, before, left)
        # The last one fills up what is executed, so that a chunk keeps its shape.
        acted[CHUNK] = torch.cat([chunk[:, 1:], chunk[:, -1:]], dim=1)
        acted[LEFT] = left - 1
        return acted.set(ACTION, chunk[:, 0])


def acting_policy(
    core: TensorDictModuleBase,
    chunk: int = 1,
    proposal: Proposal | None = None,
    critic: nn.Module | None = None,
) -> TensorDictModuleBase:
    """The policy that acts with ``core``.

    Args:
        core: An actor, or what acts with its weights.
        chunk: Actions that it gives at once.
        proposal: Of another policy where one acts; None for none.
        critic: Chooses between the two.
    """
    policy = core
    if proposal is not None and critic is not None:
        policy = ProposingPolicy(policy, proposal, critic)
    return policy if chunk == 1 else ChunkedPolicy(policy, chunk)
