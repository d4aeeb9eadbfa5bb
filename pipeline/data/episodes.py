"""Whole episodes out of a stream of collected batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import tensordict
import torch
from tensordict import TensorDict, TensorDictBase

from envs.task import PROGRESS, SUCCESS


@dataclass(frozen=True)
class FinishedEpisode:
    """One complete episode and what judges it."""

    trajectory: TensorDictBase
    """Transitions [T] in the order they happened."""
    episode_return: float
    """Undiscounted sum of rewards."""
    success: bool | None
    """Whether it ever succeeded; None where the task does not tell."""
    max_progress: float
    """Largest progress, in the task's unit; NaN where the task has none."""

    @property
    def length(self) -> int:
        """Control steps."""
        return self.trajectory.shape[0]

    @property
    def success_at_end(self) -> bool | None:
        """Whether its last step succeeded; None where the task does not tell."""
        success = self.trajectory.get(("next", SUCCESS), None)
        return None if success is None else bool(success[-1].any())

    @classmethod
    def from_trajectory(cls, trajectory: TensorDictBase) -> FinishedEpisode:
        """Reads return, success and progress off a trajectory [T]."""
        success = trajectory.get(("next", SUCCESS), None)
        progress = trajectory.get(("next", PROGRESS), None)
        return cls(
            trajectory=trajectory,
            episode_return=float(trajectory["next", "reward"].sum()),
            success=None if success is None else bool(success.any()),
            max_progress=float("nan") if progress is None else float(progress.max()),
        )


class EpisodeAssembler:
    """Joins the pieces of each environment's trajectory until the episode is done.

    Batches [N, T] cut episodes anywhere; row i of the next batch goes on where row i of this ended.

    Args:
        device: Of the batches; what is restored from a checkpoint goes there.
    """

    def __init__(self, device: torch.device | str | None = None) -> None:
        self.device = device
        self._open: dict[int, list[TensorDictBase]] = {}

    def __call__(self, batch: TensorDictBase) -> list[FinishedEpisode]:
        """Takes the next batch [N, T]; returns the episodes that ended in it."""
        done = batch["next", "done"].squeeze(-1)
        finished = []
        for i, row_done in enumerate(done):
            start = 0
            for end in (row_done.nonzero().squeeze(-1) + 1).tolist():
                pieces = [*self._open.pop(i, []), batch[i, start:end]]
                trajectory = tensordict.cat(pieces) if len(pieces) > 1 else pieces[0]
                finished.append(FinishedEpisode.from_trajectory(trajectory))
                start = end
            if start < batch.shape[1]:
                self._open.setdefault(i, []).append(batch[i, start:])
        return finished

    def state_dict(self) -> dict[str, Any]:
        """The unfinished episodes."""
        return {str(i): tensordict.cat(pieces).to_dict() for i, pieces in self._open.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._open = {
            int(i): [TensorDict(entries, [entries["action"].shape[0]], device=self.device)]
            for i, entries in state.items()
        }
