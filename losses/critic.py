"""The critics' term: regression on the soft TD target (paper, section III-A)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal, get_args

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.modules import TanhNormal

from losses import functional as F
from losses.passes import CriticPass
from losses.policy import policy_distribution
from losses.proposal import Proposal
from losses.settings import require
from losses.terms import CriticTerm, TermValue

TargetAction = Literal["sample", "mean"]


@dataclass(frozen=True)
class SoftTD(CriticTerm):
    r"""Error of the critics against ``r + gamma^n (1 - d) [Q'(s', a') - alpha log pi(a'|s')]``.

    The number n of steps to the next state is the batch's (``steps_to_next_obs``), 1 without it.
    The error is summed over the critics (:func:`~losses.functional.critic_error`).

    Attributes:
        gamma: discount per environment step, in [0, 1].
        entropy: whether the target includes the entropy bonus; RLPD's does not (arXiv:2302.02948).
        target_subset: number of critics in the target's minimum, drawn anew at each call (REDQ,
            arXiv:2101.05982); ``None`` is all.
        target_action: the policy's ``"sample"`` or ``"mean"`` action in the next state. With the
            mean, the critics value the policy without its noise (arXiv:1802.09477, without the
            smoothing); such a policy has no entropy, so ``entropy`` must be ``False``.
        distance: regression error, ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        proposal: another policy, whose action the target uses where the critics value it higher;
            ``None`` for none.
        tau: step of the target critics towards the critics at each of their updates, in [0, 1].
        name: of the term.

    Raises:
        SettingError: for a setting outside its range.
    """

    gamma: float = 0.99
    entropy: bool = True
    target_subset: int | None = None
    target_action: TargetAction = "sample"
    distance: F.CriticDistance = "l2"
    proposal: Proposal | None = None
    tau: float = 0.005
    name: str = "qvalue"

    reads: ClassVar[tuple[NestedKey, ...]] = (
        "observation",
        "action",
        ("next", "observation"),
        ("next", "reward"),
        ("next", "terminated"),
        "steps_to_next_obs",
    )
    reinforces: ClassVar[bool] = True
    logs: ClassVar[tuple[str, ...]] = ("q_data",)
    returns: ClassVar[tuple[str, ...]] = ("q_target",)

    def __post_init__(self) -> None:
        """Validate the settings."""
        super().__post_init__()
        require("gamma", self.gamma, 0.0 <= self.gamma <= 1.0, "in [0, 1]")
        require("tau", self.tau, 0.0 <= self.tau <= 1.0, "in [0, 1]")
        subset, action = self.target_subset, self.target_action
        require("target_subset", subset, subset is None or subset >= 1, "None or >= 1")
        require("target_action", action, action in get_args(TargetAction), "sample or mean")
        require(
            "entropy",
            self.entropy,
            not (self.entropy and action == "mean"),
            "False with target_action='mean', which has no density",
        )
        require(
            "entropy",
            self.entropy,
            not (self.entropy and self.proposal is not None),
            "False with a proposal, whose density is another policy's",
        )
        distances = get_args(F.CriticDistance)
        require("distance", self.distance, self.distance in distances, "l2, l1 or smooth_l1")

    def __call__(self, seen: CriticPass) -> TermValue:
        """Compute the loss; it measures ``q_data [E, R, 1]`` and ``q_target [R, 1]``.

        These are the critics' values of the batch's actions, and their regression target.
        """
        target = self.target(seen)
        loss = F.critic_error(seen.q, target, self.distance).mean()
        return TermValue(loss, {"q_data": seen.q.detach(), "q_target": target})

    @torch.no_grad()
    def target(self, seen: CriticPass) -> Tensor:
        """Return the regression target ``[R, 1]``."""
        batch = seen.batch
        next_observation = batch.next_observation
        policy: TanhNormal = policy_distribution(seen.networks.actor, next_observation)
        next_log_prob: Tensor | None = None
        if self.target_action == "mean":
            next_action = policy.deterministic_sample
        else:
            next_action, next_log_prob = policy.rsample_and_log_prob()
        value = partial(self._value, seen)
        if self.proposal is None:
            next_q = value(next_observation, next_action)
        else:
            _, next_q = self.proposal(next_observation, next_action, value)
        return F.soft_td_target(
            reward=batch.reward,
            terminated=batch.terminated,
            next_q=next_q,
            gamma=self.gamma,
            steps=batch.steps,
            next_log_prob=next_log_prob if self.entropy else None,
            temperature=seen.networks.alpha,
        )

    def _value(self, seen: CriticPass, observation: Tensor, action: Tensor) -> Tensor:
        """Return the minimum ``[R, 1]`` over the target critics, or over a random few."""
        critic, ensemble = seen.networks.target_critic, seen.networks.ensemble_size
        if self.target_subset is None or ensemble is None:
            return F.subset_minimum(critic(observation, action), self.target_subset)
        members = F.draw_members(ensemble, self.target_subset, observation.device)
        return F.subset_minimum(critic(observation, action, members=members))
