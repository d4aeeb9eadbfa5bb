"""Rules that compute the weight of an actor's term from the norms of the gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from losses.settings import require


class WeightRule(Protocol):
    """Computes the weight of a term from its schedule's weight and the gradients' norms."""

    @property
    def factor(self) -> float:
        """Number that the schedule's weight is multiplied by before the rule is called."""

    def __call__(self, weight: Tensor, reference: Tensor, own: Tensor) -> Tensor:
        """Return the weight ``[]``.

        Args:
            weight: ``[]``, the schedule's at this update times :attr:`factor`.
            reference: ``[]``, norm of the gradient of the reinforcement term.
            own: ``[]``, norm of the gradient of the term itself, unweighted.
        """


@dataclass(frozen=True)
class GradientRatio:
    """Weight ``lambda(n) ratio |g_RL| / |g|``: g has a fixed size relative to RL's gradient.

    The size is then the same whatever the scale of the rewards. Deviation: this is not in the
    paper, whose fixed lambda lets the share of imitation drift by two orders of magnitude during a
    run. Undo: ``rule=None``.

    Attributes:
        ratio: >= 0, ``weight |g| / |g_RL|`` where the schedule's lambda is 1.
    """

    ratio: float

    def __post_init__(self) -> None:
        """Validate the settings."""
        require("ratio", self.ratio, 0.0 <= self.ratio < math.inf, "finite and >= 0")

    @property
    def factor(self) -> float:
        """The ratio."""
        return self.ratio

    def __call__(self, weight: Tensor, reference: Tensor, own: Tensor) -> Tensor:
        """Return ``weight * reference / own``."""
        return weight * reference / own.clamp_min(1e-12)
