"""What demonstrations of a task look like: sizes, bounds, and what can be computed from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envs.flatten import Leaf

Floats = NDArray[np.floating]
Measure = Callable[[Floats], NDArray[np.generic]]
"""A pure function of observations [..., O]: a reward, a flag or a progress [...]."""


@dataclass(frozen=True)
class StartKey:
    """A vector that says where an episode begins, as files store it.

    Attributes:
        name: in an :class:`~envs.demonstrations.episode.Episode`'s ``start``.
        size: of the vector.
        aliases: what files of others call it.
        axes: names of its entries, for tables and maps; none numbers them.
        unit: of its entries.
    """

    name: str
    size: int
    aliases: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        if self.axes and len(self.axes) != self.size:
            raise ValueError(f"{self.name} has {self.size} entries and {len(self.axes)} axes")

    @property
    def names(self) -> tuple[str, ...]:
        """All names that a file may use."""
        return (self.name, *self.aliases)


@dataclass(frozen=True)
class DemoSchema:
    """Demonstrations of one task.

    Attributes:
        describes: what fits, for messages: ``the Adroit door (38-d or 39-d observations, ...)``.
        observation_size: O of the task.
        action_size: A of the task.
        observation_widths: widths that files may have as well; what is beyond O is dropped.
        action_bound: largest magnitude of a recorded action entry, in the task's units of [-1, 1].
            What is beyond 1 is clipped and counted; what is beyond this is another kind of action.
        action_low: of the units in which files hold actions, one number per entry; they are
            rescaled to [-1, 1]. None where files hold them in [-1, 1].
        action_high: likewise.
        observation_keys: arrays of which an observation is made, by path (``goal/position``), for
            files that hold several; None takes all of them.
        discrete: arrays of integers, by path; they become one-hot.
        step_reward: of a step, from observations [B, O], actions [B, A] in [-1, 1] and the
            observations that follow them; None leaves the files' own rewards.
        start: vectors that say where an episode begins.
        reward: of arriving at an observation; None leaves the files' own rewards.
        reward_tolerance: within which a file's reward agrees with the task's.
        terminated: whether an observation ends an episode; None takes the files' word for it.
        success: whether the task is accomplished there; None where only files can say.
        progress: how far it is there; None where only files can say.
        continues: whether a row continues the episode of the row before, for files that cut
            episodes; None never joins any.
        bundled: recordings that come with the task, the source ``bundled``.
        horizon: control steps of an episode, for reports; None where there is no fixed number.
        full_progress: beyond which no bound on progress makes sense; None for no limit.
    """

    describes: str
    observation_size: int
    action_size: int
    observation_widths: tuple[int, ...] = ()
    action_bound: float = 1.1
    action_low: tuple[float, ...] | None = None
    action_high: tuple[float, ...] | None = None
    observation_keys: tuple[str, ...] | None = None
    discrete: tuple[Leaf, ...] = ()
    step_reward: Callable[[Floats, Floats, Floats], Floats] | None = None
    start: tuple[StartKey, ...] = ()
    reward: Measure | None = None
    reward_tolerance: float = 0.0
    terminated: Measure | None = None
    success: Measure | None = None
    progress: Measure | None = None
    continues: Callable[[Floats, Floats], bool] | None = None
    bundled: Path | None = None
    horizon: int | None = None
    full_progress: float | None = None

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of an observation that files may have."""
        return (self.observation_size, *self.observation_widths)

    def __post_init__(self) -> None:
        low, high = self.action_low, self.action_high
        if (low is None) != (high is None):
            raise ValueError("action_low and action_high are given together or not at all")
        if low is not None and high is not None:
            if {len(low), len(high)} != {self.action_size}:
                raise ValueError(
                    f"action_low and action_high need {self.action_size} numbers each, got "
                    f"{len(low)} and {len(high)}"
                )
            if not all(a < b and np.isfinite([a, b]).all() for a, b in zip(low, high, strict=True)):
                raise ValueError(
                    f"action_low must be below action_high, both finite: {low}, {high}"
                )
