"""Rules that set the weight of an actor's term by what the gradients are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from losses.settings import require


class WeightRule(Protocol):
    """How the weight of a term follows from its schedule's and from the gradients' sizes."""

    @property
    def factor(self) -> float:
        """On the schedule's weight, before it is handed to the rule."""

    def __call__(self, weight: Tensor, reference: Tensor, own: Tensor) -> Tensor:
        """Return the weight ``[]``.

        Args:
            weight: ``[]``, the schedule's at this update times :attr:`factor`.
            reference: ``[]``, norm of the gradient of the reinforcement term.
            own: ``[]``, norm of the gradient of the term itself, unweighted.
        """


@dataclass(frozen=True)
class GradientRatio:
    """``lambda(n) ratio |g_RL| / |g|``: a term's gradient has a fixed size relative to RL's.

    Whatever the scale of the rewards. Deviation: it is not in the paper, whose fixed lambda lets
    the share of imitation drift by two orders of magnitude during a run; no rule is the paper's.

    Attributes:
        ratio: >= 0, the term's share at a schedule's weight of 1.
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
