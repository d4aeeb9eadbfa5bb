"""The actor's reinforcement term: the entropy-regularised value (paper, section III-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from torchrl.objectives.utils import hold_out_net

from losses import functional as F
from losses.passes import ActorPass
from losses.settings import require
from losses.terms import ActorTerm, TermValue

CriticReduction = Literal["min", "mean"]


@dataclass(frozen=True)
class SoftValue(ActorTerm):
    """``alpha log pi(a|s) - Q(s, a)`` of actions a drawn from the policy, mean over the R rows.

    Attributes:
        value: what Q is of the critics' values, ``"min"`` or ``"mean"``.
        name: of the term.

    Raises:
        SettingError: for an unknown ``value``.
    """

    value: CriticReduction = "min"
    name: str = "rl"

    reinforces: ClassVar[bool] = True
    logs: ClassVar[tuple[str, ...]] = ("entropy", "q_policy")

    def __post_init__(self) -> None:
        """Validate the settings."""
        super().__post_init__()
        require("value", self.value, self.value in F.ENSEMBLE_VALUES, "min or mean")

    @property
    def loss_key(self) -> str:
        """The name that TorchRL's ``SACLoss`` uses."""
        return "loss_actor"

    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss; it measures ``entropy [R]`` in nats and ``q_policy [R, 1]``.

        ``q_policy`` is the critics' value of the sampled actions. Where it rises far above
        ``q_data``, the critics overestimate actions that are not in the data.
        """
        sample, networks = seen.sample, seen.networks
        # The action must carry a gradient through the critics, their parameters must not get one.
        with hold_out_net(networks.critic):
            q = F.ENSEMBLE_VALUES[self.value](networks.critic(sample.observation, sample.action))
        loss = F.actor_objective(sample.log_prob, q, networks.alpha).mean()
        return TermValue(loss, {"entropy": -sample.log_prob.detach(), "q_policy": q.detach()})
