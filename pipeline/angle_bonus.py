"""A training reward for how far the door is open, on top of the task's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from torch import Tensor

from envs.door.task import HINGE

FULL_BONUS_ANGLE: Final = 1.5
"""Hinge angle (rad) beyond which the bonus grows no further: within reach of the stop at 1.57."""


@dataclass(frozen=True)
class AngleBonus:
    """Pays ``per_rad * min(hinge, 1.5 rad)`` for arriving at an observation.

    Deviation: the task's bonuses (paper, section IV-A) are steps at 0.2, 1.0 and 1.35 rad. In
    between, a door that swings on earns hardly more than one that stands; what paying for it did
    to learning is in docs/results/ablations.md, section 14. Evaluations and the logged training
    returns stay the task's; ``loss.angle_bonus=0`` undoes it.

    Args:
        per_rad: Reward per control step and rad, >= 0.

    Raises:
        ValueError: If ``per_rad`` is negative.
    """

    per_rad: float

    def __post_init__(self) -> None:
        if self.per_rad < 0.0:
            raise ValueError(f"loss.angle_bonus must be at least 0, got {self.per_rad}")

    def __call__(self, next_observation: Tensor) -> Tensor:
        """The bonus ``[..., 1]`` of observations after the action, ``[..., 38]``."""
        hinge = next_observation[..., HINGE : HINGE + 1]
        return self.per_rad * hinge.clamp(max=FULL_BONUS_ANGLE)
