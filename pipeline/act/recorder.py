"""Keeps what the episodes of an evaluation saw and did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor


class SeesSteps(Protocol):
    """Whatever an evaluation shows its steps to."""

    def __call__(self, step: TensorDictBase, active: Tensor) -> None:
        """Takes a step of N copies, of which only the ``active`` ones [N, 1] still play."""

    def finish_wave(self) -> None:
        """The copies have played their episodes to the end; others follow."""


@dataclass(frozen=True)
class Together:
    """Several of them."""

    parts: Sequence[SeesSteps]

    def __call__(self, step: TensorDictBase, active: Tensor) -> None:
        """Shows the step to all."""
        for part in self.parts:
            part(step, active)

    def finish_wave(self) -> None:
        """Tells all."""
        for part in self.parts:
            part.finish_wave()


class Recorder:
    """Observations and actions of the first ``limit`` episodes.

    Args:
        limit: Episodes to keep.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._episodes: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
        self._steps: list[tuple[Tensor, Tensor, Tensor]] = []
        self._last: Tensor | None = None

    def __call__(self, step: TensorDictBase, active: Tensor) -> None:
        """Takes a step of N copies, of which only the ``active`` ones [N, 1] still play."""
        kept = slice(0, self.limit - len(self._episodes))
        seen = step["observation"][kept].clone(), step["action"][kept].clone()
        self._steps.append((*seen, active[kept, 0].clone()))
        after = step["next", "observation"][kept].clone()
        still = active[kept]
        self._last = after if self._last is None else torch.where(still, after, self._last)

    def finish_wave(self) -> None:
        """The copies have played their episodes to the end; others follow."""
        if self._last is None:
            return
        observations, actions, active = (
            torch.stack(part, 1) for part in zip(*self._steps, strict=True)
        )
        lengths = active.sum(1).tolist()
        for i, length in enumerate(lengths):
            path = torch.cat([observations[i, :length], self._last[i : i + 1]])
            self._episodes.append((path.cpu().numpy(), actions[i, :length].cpu().numpy()))
        self._steps, self._last = [], None

    def episodes(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Observations [T + 1, O] and actions [T, A] of each episode, in their order."""
        return list(self._episodes)


class ColumnRecorder:
    """Columns that an environment writes besides, after each step of every episode.

    Args:
        columns: Their keys, [N, K] each.
    """

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self._steps: list[list[Tensor]] = []
        self._waves: list[list[NDArray[Any]]] = []

    def __call__(self, step: TensorDictBase, active: Tensor) -> None:
        """Takes a step of N copies, of which only the ``active`` ones [N, 1] still play."""
        after = step["next"]
        self._steps.append([after[column] * active for column in self.columns])

    def finish_wave(self) -> None:
        """The copies have played their episodes to the end; others follow."""
        stacked = (torch.stack(steps, 1) for steps in zip(*self._steps, strict=True))
        self._waves.append([column.cpu().numpy() for column in stacked])
        self._steps = []

    def joined(self, count: int) -> dict[str, NDArray[Any]]:
        """The columns of the first ``count`` episodes, [E, T, K]; zeros behind an episode's end."""
        longest = max(wave[0].shape[1] for wave in self._waves)
        return {
            column: np.concatenate([_padded(wave[i], longest) for wave in self._waves])[:count]
            for i, column in enumerate(self.columns)
        }


def _padded(values: NDArray[Any], steps: int) -> NDArray[Any]:
    beyond = [(0, 0)] * values.ndim
    beyond[1] = (0, steps - values.shape[1])
    return np.pad(values, beyond)
