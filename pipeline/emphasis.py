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

    Deviation: the paper imitates every step alike, and so does ``closed=1 open=1``, the default. A
    hand that leaves what it was shown before the door moves is fast and slips off handles that it
    has not turned far enough; what other factors do: docs/results/ablations.md, sections 18, 19.

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
