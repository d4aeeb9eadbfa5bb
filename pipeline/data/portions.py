"""Rows of trajectories that arrive in portions, which cut them anywhere."""

from __future__ import annotations

from typing import Any

import tensordict
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from envs.task import PROGRESS
from pipeline.data.rows import TransitionRows

KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "truncated"),
)
"""What a row is made of, and these where the environment tells them."""
TOLD = (PROGRESS, ("next", PROGRESS))


class PortionRows:
    """Turns collected portions into the rows that the uncut trajectories have.

    A row at time t is known n - 1 steps later, or when its episode ends. What is not known at the
    end of a portion waits for the next one: rows look fewer steps ahead where an episode ends, and
    nowhere else. What still waits when a run ends is never handed out.

    Args:
        to_rows: How trajectories become rows.
        device: Of the portions; what is restored from a checkpoint goes there.
    """

    def __init__(self, to_rows: TransitionRows, device: torch.device | str | None = None) -> None:
        self.to_rows = to_rows
        self.device = device
        self._last: TensorDictBase | None = None  # [N, up to n - 1] steps
        self._waiting: Tensor | None = None  # [N, up to n - 1], which of their rows are not known

    def __call__(self, portion: TensorDictBase) -> TensorDictBase:
        """Takes the next portion [N, T]; returns the rows [R] that are known now, by environment.

        Row i of a portion goes on where row i of the one before ended.
        """
        n_step = self.to_rows.n_step
        if n_step == 1:
            return self.to_rows(portion)
        steps: TensorDictBase = portion.select(*KEYS, *TOLD, strict=False)
        waiting = torch.ones(steps.shape, dtype=torch.bool, device=steps.device)
        if self._last is not None and self._waiting is not None:
            steps = tensordict.cat([self._last, steps], dim=1)
            waiting = torch.cat([self._waiting, waiting], dim=1)
        rows = self.to_rows.each(steps)
        ahead = rows["steps_to_next_obs"].reshape(steps.shape)
        last = torch.arange(steps.shape[1], device=ahead.device) + ahead - 1
        known = (ahead == n_step) | steps["next", "done"].squeeze(-1).gather(1, last)
        kept = slice(1 - n_step, None)
        self._last = steps[:, kept].clone()
        self._waiting = (waiting & ~known)[:, kept].clone()
        return self.to_rows.whole(rows[(waiting & known).flatten()])

    def state_dict(self) -> dict[str, Any]:
        """The last steps of each environment, and which of their rows still wait."""
        if self._last is None:
            return {}
        return {"last": self._last.to_dict(), "waiting": self._waiting}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._last = self._waiting = None
        if state:
            self._waiting = state["waiting"].to(self.device)
            shape = state["waiting"].shape
            self._last = TensorDict(state["last"], shape).to(self.device or "cpu")
