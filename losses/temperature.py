"""The temperature's term, which keeps the policy's entropy at a target."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

from torch import Tensor
from torchrl.modules import ProbabilisticActor

from losses import functional as F
from losses.passes import Networks
from losses.settings import require
from losses.terms import Term, TermValue


@dataclass(frozen=True)
class Temperature(Term):
    """``-log(alpha) (log pi(a|s) + H)`` of actions drawn from the policy, mean over the R rows.

    Attributes:
        init: initial entropy weight alpha, > 0.
        target_entropy: H in nats; ``"auto"`` is minus the number of action dimensions, read from
            the actor's spec.
        learn: ``False`` keeps alpha at ``init``.
        name: of the term.

    Raises:
        SettingError: for a setting outside its range.
    """

    init: float = 0.1
    target_entropy: float | Literal["auto"] = "auto"
    learn: bool = True
    name: str = "alpha"

    logs_after_step: ClassVar[tuple[str, ...]] = ("alpha",)

    def __post_init__(self) -> None:
        """Validate the settings."""
        super().__post_init__()
        require("init", self.init, 0.0 < self.init < math.inf, "> 0")
        entropy = self.target_entropy
        holds = entropy == "auto" or not isinstance(entropy, str)
        require("target_entropy", entropy, holds, "auto or a number of nats")

    def resolved(self, actor: ProbabilisticActor) -> Self:
        """Return the term with the target entropy as a number.

        Raises:
            ValueError: for ``"auto"`` and an actor without a spec.
        """
        entropy = self.target_entropy
        number = _negative_action_size(actor) if entropy == "auto" else float(entropy)
        return replace(self, target_entropy=number)

    def __call__(self, log_prob: Tensor, log_alpha: Tensor) -> TermValue:
        """Compute the loss from the log-densities ``[R]`` of sampled actions.

        Args:
            log_prob: ``[R]`` in nats.
            log_alpha: ``[]``, the parameter that is trained.
        """
        entropy = float(self.target_entropy)
        return TermValue(F.temperature_objective(log_prob, log_alpha, entropy).mean())

    def after_step(self, networks: Networks) -> Mapping[str, Tensor]:
        """Return the temperature ``[]``."""
        return {"alpha": networks.alpha}

    def constants(self) -> Mapping[str, float]:
        """Return the target entropy in nats."""
        return {"target_entropy": float(self.target_entropy)}


def _negative_action_size(actor: ProbabilisticActor) -> float:
    """Return minus the number of action dimensions that the actor's spec states."""
    action_key = actor[-1].out_keys[0]
    if actor.spec is None or actor.spec.get(action_key) is None:
        raise ValueError(
            "target_entropy='auto' needs the size of the action: build the actor with spec=, "
            "or give target_entropy as a number"
        )
    return -float(actor.spec[action_key].shape[-1])
