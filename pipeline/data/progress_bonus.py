"""A training reward for how far the task has progressed, on top of the task's own."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tensordict import TensorDictBase
from torch import Tensor

from envs.task import PROGRESS


@dataclass(frozen=True)
class ProgressBonus:
    """Pays ``per_unit * min(progress, cap)`` for arriving somewhere.

    Deviation: the paper trains on the task's reward alone, which on the door (section IV-A) are
        steps
    at 0.2, 1.0 and 1.35 rad: in between, a door that swings on earns hardly more than one that
    stands. What paying for it did to learning is in docs/lab/notes/19-progress-bonus.md.
    Evaluations and the logged training returns stay the task's; ``loss.progress_bonus=0`` undoes
    it.

    Args:
        per_unit: Reward per control step and unit of progress, >= 0.
        cap: Progress beyond which the bonus grows no further; None for no limit.

    Raises:
        ValueError: If ``per_unit`` is negative or not finite.
    """

    per_unit: float
    cap: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.per_unit) and self.per_unit >= 0.0):
            raise ValueError(
                f"loss.progress_bonus must be finite and at least 0, got {self.per_unit}"
            )

    def __call__(self, after: TensorDictBase) -> Tensor:
        """The bonus ``[..., 1]`` of what an environment wrote after an action."""
        progress: Tensor = after[PROGRESS]
        return self.per_unit * (progress if self.cap is None else progress.clamp(max=self.cap))
