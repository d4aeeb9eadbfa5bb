"""What multiplication tries next, by what has succeeded: sources and speeds are drawn by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.variation import Attempt

_AS_MANY: Final = 2.0
"""Attempts that the average of a source stands for in each part of its speeds."""


@dataclass
class Tally:
    """Attempts and kept episodes, and what follows for the next round.

    Attributes:
        tried: [sources, parts of the range of speeds].
        kept: likewise.
        cap: episodes that a source gives at most.
        config: what is tried.
    """

    tried: NDArray[np.int64]
    kept: NDArray[np.int64]
    cap: int
    config: MultiplyConfig

    @classmethod
    def empty(cls, sources: int, config: MultiplyConfig) -> Tally:
        """Of nothing tried yet.

        Raises:
            DemonstrationError: there are no sources.
        """
        if sources == 0:
            raise DemonstrationError("multiplication", "got no episodes", "Check the source")
        cap = int(np.ceil(config.balance * config.target_episodes / sources))
        zeros = np.zeros((sources, config.speed_bins), dtype=np.int64)
        return cls(zeros, zeros.copy(), cap, config)

    def room_for(self, source: int) -> bool:
        """Whether another episode of a source would be kept."""
        return bool(self.kept[source].sum() < self.cap)

    def record(self, attempt: Attempt, *, kept: bool) -> None:
        """Notes one attempt."""
        at = attempt.source, self._part(attempt.speed)
        self.tried[at] += 1
        self.kept[at] += kept

    def weights(self) -> NDArray[np.float64]:
        """Weight [sources]: what is still missing, times how often the source succeeds."""
        missing = (self.cap - self.kept.sum(axis=1)) / self.cap
        return np.asarray(missing * self._success())

    def speeds(self) -> NDArray[np.float64]:
        """Weight [sources, parts]: the square of how often the source succeeds there.

        A part that was hardly tried is taken for the average of its source. To only succeed, the
        best part alone would do; a policy is to see all speeds.
        """
        average = self._success()[:, None]
        found = (self.kept + _AS_MANY * average) / (self.tried + _AS_MANY)
        return np.asarray(found**2)

    def next_round(self, missing: int, max_attempts: int) -> int:
        """Attempts to make next: about as many as the missing episodes will need."""
        success = (self.kept.sum() + 1.0) / (self.tried.sum() + 2.0)
        needed = int(np.ceil(missing / success))
        return max(1, min(self.config.round_size, needed, max_attempts - int(self.tried.sum())))

    def _success(self) -> NDArray[np.float64]:
        # Laplace's estimate starts at 1/2, so that every source is tried before it is judged.
        return np.asarray((self.kept.sum(axis=1) + 1.0) / (self.tried.sum(axis=1) + 2.0))

    def _part(self, speed: float) -> int:
        low, high = self.config.speed_low, self.config.speed_high
        share = 0.0 if low == high else (speed - low) / (high - low)
        return min(int(share * self.config.speed_bins), self.config.speed_bins - 1)
