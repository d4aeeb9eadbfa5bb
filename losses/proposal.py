"""Two policies propose an action, and the critics choose (imitation bootstrapped RL)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.modules import ProbabilisticActor, TanhNormal

from losses.policy import policy_distribution
from losses.settings import require


@dataclass(frozen=True)
class Proposal:
    r"""Choice between the actions of an imitation policy and of the policy that learns.

    .. math:: a^* = \arg\max_{a \in \{a_{IL}, a_{RL}\}} Q(s, a)

    Source: arXiv:2311.02198, section 4, where it is the actor proposal when acting, and the
    bootstrap proposal in the critics' targets. The soft variant draws ``a`` with probability
    :math:`\propto \exp(\beta Q(s, a))`.

    Attributes:
        actor: the imitation policy, which is not trained; its mean action is proposed.
        beta: of the soft variant; ``None`` takes the action with the higher value.

    Raises:
        SettingError: for a ``beta`` that is not positive.
    """

    actor: ProbabilisticActor
    beta: float | None = None

    def __post_init__(self) -> None:
        """Validate the settings."""
        require("beta", self.beta, self.beta is None or self.beta > 0.0, "None or > 0")

    @torch.no_grad()
    def __call__(
        self,
        observation: Tensor,
        own: Tensor,
        value: Callable[[Tensor, Tensor], Tensor],
        *,
        greedy: bool = False,
    ) -> tuple[Tensor, Tensor]:
        """Choose between the imitated action and ``own``.

        Args:
            observation: ``[B, O]``.
            own: ``[B, A]``, the actions of the policy that learns.
            value: function that is called once for both proposals, with observations ``[2 B, O]``
                and actions ``[2 B, A]``, and returns their values ``[2 B, 1]``.
            greedy: whether to take the action with the higher value even with a ``beta``.

        Returns:
            The chosen actions ``[B, A]`` and their values ``[B, 1]``.
        """
        imitating: TanhNormal = policy_distribution(self.actor, observation)
        shown = imitating.deterministic_sample
        # At once, so that both are judged by the same critics where only some are asked.
        values = value(torch.cat([observation, observation]), torch.cat([own, shown]))
        of_own, of_shown = values.chunk(2)
        gain = of_shown - of_own
        if self.beta is not None and not greedy:
            # Softmax of two: the imitated one with probability sigmoid(beta gain).
            takes_shown = torch.rand_like(gain) < torch.sigmoid(self.beta * gain)
        else:
            takes_shown = gain > 0.0
        return torch.where(takes_shown, shown, own), torch.where(takes_shown, of_shown, of_own)
