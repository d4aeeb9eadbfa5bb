"""What differs from one training episode to the next; evaluations play the task as it is."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Final

from pydantic import Field
from pydantic.dataclasses import dataclass as settings

from envs import Task
from envs.disturbing import Disturbance
from pipeline.settings import STRICT, NotNegative, Rate

KEY: Final = "task.randomise."
Delay = Annotated[NotNegative, Field(le=1000)]
"""Longer than any episode in which a late action could still help."""


@settings(frozen=True, kw_only=True, config=STRICT)
class RandomiseSettings:
    """Ranges from which each training episode of each copy draws a value; low = high is fixed."""

    # Standard deviation of normal noise, on entries of observations and of actions in [-1, 1].
    observation_noise: tuple[Rate, Rate] = (0.0, 0.0)
    action_noise: tuple[Rate, Rate] = (0.0, 0.0)
    delay: tuple[Delay, Delay] = (0, 0)  # control steps until an action is played
    # Of the model, by the task's names, drawn in their logarithm: task.randomise.factors.mass=[...]
    factors: dict[str, tuple[float, float]] = field(default_factory=dict)
    # How far beyond its box a thing may begin, below and above: task.randomise.outside.door_x=[...]
    outside: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def disturbance(self) -> Disturbance:
        """As environments take it."""
        return Disturbance(
            observation_noise=self.observation_noise,
            action_noise=self.action_noise,
            delay=self.delay,
            factors=self.factors,
            outside=self.outside,
        )

    def require(self, task: Task) -> None:
        """Refuse what the task cannot be disturbed by, or nobody could solve.

        Raises:
            ValueError: The message names the key.
        """
        self.disturbance.require(task.disturb, task.name, KEY)
