"""How a task varies its demonstrations: what multiplication asks of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.episode import Episode
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.schema import DemoSchema


class Attempt(Protocol):
    """One variation of one source."""

    @property
    def source(self) -> int:
        """Index of the episode that is varied."""
        ...

    @property
    def speed(self) -> float:
        """Relative to the recording."""
        ...


A = TypeVar("A", bound=Attempt)


class Player(Protocol[A]):
    """Draws variations of given episodes and plays them."""

    def draw(
        self, index: int, weights: NDArray[np.float64], speeds: NDArray[np.float64] | None = None
    ) -> A:
        """Attempt number ``index``, the same for the same index, settings and weights.

        Args:
            index: number of the attempt.
            weights: [sources], not negative: how much each source is wanted.
            speeds: [sources, parts], not negative: how much each of these equal parts of the range
                of speeds is wanted of a source; None is alike.
        """
        ...

    def play(self, attempts: Sequence[A]) -> Iterator[Episode | None]:
        """Plays attempts together; an episode of kind ``multiplied`` for each success, in order."""
        ...


class Variation(Protocol):
    """How a task varies its demonstrations."""

    @property
    def schema(self) -> DemoSchema:
        """Of the episodes."""
        ...

    @property
    def identity(self) -> str:
        """All that the attempts depend on besides episodes and settings: part of a cache's key."""
        ...

    def open(
        self, episodes: Sequence[Episode], settings: MultiplyConfig, num_threads: int | None
    ) -> AbstractContextManager[Player[Any]]:
        """Makes ready to vary ``episodes``.

        Raises:
            DemonstrationError: an episode lacks what varying it needs.
        """
        ...
