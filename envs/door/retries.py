"""Doors that were not opened come back: where training episodes start beside fresh doors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WAITING_DOORS = 64
"""Most doors that wait for another episode; the one that waits longest leaves first."""


class FailedDoors:
    """Queue of door positions to be tried again after an episode that did not open them.

    A uniform sample of doors holds few of those that a good policy misses, so that the critic sees
    least where it is wrong.  Going back to starting points on which a policy still learns is
    prioritised level replay (Jiang et al., 2021, arXiv:2010.03934); here the score is failure.

    Args:
        repeats: How often a door waits for each episode that failed on it; 0 keeps none.

    Raises:
        ValueError: If `repeats` is negative.
    """

    def __init__(self, repeats: int = 0) -> None:
        if repeats < 0:
            raise ValueError(f"retry_failed must not be negative, got {repeats}")
        self.repeats = repeats
        self._waiting = np.empty((0, 3))

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, positions: NDArray[np.float64]) -> None:
        """Doors [K, 3] (m) on which an episode has failed."""
        again = np.repeat(positions, self.repeats, axis=0)
        self._waiting = np.concatenate([self._waiting, again])[-WAITING_DOORS:]

    def take(self) -> NDArray[np.float64]:
        """The door, shape [3], that waits longest; it waits no more.

        Raises:
            IndexError: If none waits.
        """
        first, self._waiting = self._waiting[0], self._waiting[1:]
        return first

    def get_state(self) -> NDArray[np.float64]:
        """Positions that wait, shape [K, 3], oldest first."""
        return self._waiting.copy()

    def set_state(self, positions: NDArray[np.float64]) -> None:
        """Go on from what `get_state` returned."""
        self._waiting = positions.reshape(-1, 3).copy()
