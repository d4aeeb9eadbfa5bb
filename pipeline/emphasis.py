"""Which part of a demonstration is imitated how strongly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from envs.door.task import HINGE


@dataclass(frozen=True)
class OpeningEmphasis:
    """Weighs the imitation of demonstrated steps before and after the door has begun to open.

    Deviation: the paper imitates every step alike. How a hand gets to a handle and turns it can be
    learned faster than it is shown and does not decide whether the door opens; what it does while
    the door swings does (docs/results/ablations.md, section 18). ``closed=1`` and ``open=1`` undo
    it.

    Args:
        closed: Factor on the imitation error of steps up to ``angle``, >= 0.
        open: Factor beyond it, >= 0.
        angle: Of the hinge in rad.

    Raises:
        ValueError: If a factor is negative or not finite.
    """

    closed: float
    open: float
    angle: float

    def __post_init__(self) -> None:
        for name in ("closed", "open"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(
                    f"loss.bc_emphasis.{name} must be finite and at least 0, got {value}"
                )

    def __call__(self, observation: Tensor) -> Tensor:
        """The factors ``[...]`` of steps from observations ``[..., 38]``."""
        return torch.where(observation[..., HINGE] > self.angle, self.open, self.closed)
