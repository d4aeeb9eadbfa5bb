"""The actor imitates what turned out better than its critics expect (self-imitation learning)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.modules import TanhNormal

from losses import functional as F
from losses.actor import CriticReduction
from losses.imitation import ErrorName
from losses.imitation_errors import IMITATION_ERRORS, clamp_to_support
from losses.passes import ActorPass, Networks
from losses.policy import draw, policy_distribution
from losses.schedules import ConstantWeight, Schedule
from losses.settings import require
from losses.terms import ActorTerm, TermValue


@dataclass(frozen=True)
class SelfImitation(ActorTerm):
    r"""``-log pi(a|s) max(R - V(s), 0)``, mean over the rows whose episode's end is known.

    Source: arXiv:1806.05635, section 3. Rows have a known end if they come from whole episodes,
    demonstrations or the policy's own; their entry ``to_end`` says so
    (:attr:`~losses.batch.Batch.to_end`).

    V is SAC's soft value, ``Q(s, a') - alpha log pi(a'|s)`` of one sampled ``a' ~ pi``; in the
    paper it is a separate network. R is the discounted sum of rewards until the episode's end.

    Deviation: where a time limit ends an episode, the discounted V of its last state is added to
    R, as in the critics' targets. The paper's return ends there, so that with rewards below zero
    the last actions before the limit look good whatever they are. Undo: ``bootstrap=False``.

    Attributes:
        weight: of the term, a number or a schedule of the number of updates.
        gamma: discount per environment step, in [0, 1].
        error: ``"nll"`` (the paper), or another error of :class:`~losses.Imitation`.
        margin: actions are kept this far inside (-1, 1) before they are scored.
        value: what Q is of the critics' values, ``"min"`` or ``"mean"``.
        entropy: whether V includes the entropy bonus; the same as in the critics' targets.
        bootstrap: whether V of the last state is added to a return that a time limit ends.
        cap: larger advantages are reduced to this; ``None`` for no limit.
        name: of the term.

    Raises:
        SettingError: for a setting outside its range.
    """

    weight: Schedule | float = ConstantWeight(1.0)  # noqa: RUF009 - frozen
    gamma: float = 0.99
    error: ErrorName = "nll"
    margin: float = 1e-2
    value: CriticReduction = "min"
    entropy: bool = True
    bootstrap: bool = True
    cap: float | None = None
    name: str = "self_imitation"

    reads: ClassVar[tuple[NestedKey, ...]] = (
        "observation",
        "action",
        "imitated_action",
        "to_end",
    )
    logs: ClassVar[tuple[str, ...]] = ("better_share",)

    def __post_init__(self) -> None:
        """Validate the settings."""
        super().__post_init__()
        require("gamma", self.gamma, 0.0 <= self.gamma <= 1.0, "in [0, 1]")
        require("error", self.error, self.error in IMITATION_ERRORS, "nll, mse or fixed_width")
        require("margin", self.margin, 0.0 < self.margin < 1.0, "in (0, 1)")
        require("value", self.value, self.value in F.ENSEMBLE_VALUES, "min or mean")
        require("cap", self.cap, self.cap is None or self.cap > 0.0, "None or > 0")

    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss; a constant 0 if the batch has no ``to_end``.

        It measures ``better_share []``, the share of the rows with a known end whose return is
        above V.
        """
        shown = seen.demonstrations
        action, end = shown.batch.demonstrated_action, shown.batch.to_end
        if end is None:
            nothing = action.new_zeros(())
            return TermValue(nothing, {"better_share": nothing})
        known = end["steps"].squeeze(-1) > 0
        advantage = self._advantage(seen.networks, shown.policy, shown.batch.observation, end)
        error = IMITATION_ERRORS[self.error](shown.policy, clamp_to_support(action, self.margin))
        better = F.masked_mean((advantage > 0.0).to(error.dtype), known)
        return TermValue(F.masked_mean(error * advantage, known), {"better_share": better})

    @torch.no_grad()
    def _advantage(
        self, networks: Networks, policy: TanhNormal, observation: Tensor, end: TensorDictBase
    ) -> Tensor:
        """Return ``[D]``; of rows without a known end it is any number."""
        last = policy_distribution(networks.actor, end["observation"])
        returns = F.soft_td_target(
            reward=end["reward"],
            # Without a bootstrap, every end counts as a termination.
            terminated=end["terminated"] if self.bootstrap else end["steps"] >= 0,
            # This V has the entropy bonus already, where there is one.
            next_q=self._value(networks, last, end["observation"]).unsqueeze(-1),
            gamma=self.gamma,
            steps=end["steps"],
        )
        value = self._value(networks, policy, observation)
        return F.positive_advantage(returns.squeeze(-1), value, self.cap)

    def _value(self, networks: Networks, policy: TanhNormal, observation: Tensor) -> Tensor:
        """Return V ``[D]``."""
        action, log_prob = draw(policy, slice(None))
        q = F.ENSEMBLE_VALUES[self.value](networks.critic(observation, action)).squeeze(-1)
        return q - networks.alpha * log_prob if self.entropy else q
