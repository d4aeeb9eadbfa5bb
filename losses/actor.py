"""The actor's reinforcement term: the entropy-regularised value (paper, section III-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from torchrl.objectives.utils import hold_out_net

from losses import functional as F
from losses.passes import ActorPass
from losses.settings import require
from losses.terms import ActorTerm, TermValue

EnsembleValue = Literal["min", "mean"]


@dataclass(frozen=True)
class SoftValue(ActorTerm):
    """``alpha log pi(a|s) - Q(s, a)`` of the policy's own actions, mean over the R rows.

    Attributes:
        value: the critics' ``"min"`` or ``"mean"`` is Q.
        name: of the term.

    Raises:
        SettingError: for an unknown ``value``.
    """

    value: EnsembleValue = "min"
    name: str = "rl"

    reinforces: ClassVar[bool] = True
    logs: ClassVar[tuple[str, ...]] = ("entropy", "q_policy")

    def __post_init__(self) -> None:
        """Validate the settings."""
        super().__post_init__()
        require("value", self.value, self.value in F.ENSEMBLE_VALUES, "min or mean")

    @property
    def loss_key(self) -> str:
        """As TorchRL's ``SACLoss`` calls it."""
        return "loss_actor"

    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss; measured are ``entropy [R]`` in nats and ``q_policy [R, 1]``.

        The second is the value of the sampled actions: it rising away from ``q_data`` is the
        critics' overestimation off the data.
        """
        sample, networks = seen.sample, seen.networks
        # The action must carry a gradient through the critics, their parameters must not get one.
        with hold_out_net(networks.critic):
            q = F.ENSEMBLE_VALUES[self.value](networks.critic(sample.observation, sample.action))
        loss = F.actor_objective(sample.log_prob, q, networks.alpha).mean()
        return TermValue(loss, {"entropy": -sample.log_prob.detach(), "q_policy": q.detach()})
