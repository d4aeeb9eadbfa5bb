"""Which part of a demonstration is imitated how strongly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from envs.task import PROGRESS


@dataclass(frozen=True)
class ProgressEmphasis:
    """Weighs the imitation of demonstrated steps before and after the task has progressed so far.

    Deviation: the paper imitates every step alike, and so does ``before=1 beyond=1``, the default.
        A
    hand that leaves what it was shown before the door moves is fast and slips off handles that it
    has not turned far enough; what other factors do: docs/lab/notes/24-emphasis.md.

    Args:
        before: Factor on the imitation error of steps up to ``progress``, >= 0.
        beyond: Factor of those beyond it, >= 0.
        progress: In the task's unit.

    Raises:
        ValueError: If a factor is negative or not finite.
    """

    before: float
    beyond: float
    progress: float

    def __post_init__(self) -> None:
        for name in ("before", "beyond"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(
                    f"loss.bc_emphasis.{name} must be finite and at least 0, got {value}"
                )

    def __call__(self, rows: TensorDictBase) -> Tensor:
        """The factors ``[B]`` of rows [B] with their ``progress`` [B, 1] before the action."""
        beyond = rows[PROGRESS].squeeze(-1) > self.progress
        return torch.where(beyond, self.beyond, self.before)
