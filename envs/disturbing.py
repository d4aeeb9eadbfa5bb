"""What can be made harder, or other than it was in training: values, ranges, a task's own part.

Noise and delay need nothing of a task. What its model can be changed in and where its things may
stand, the task says (`Task.disturb`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

Range = tuple[float, float]
Floats = NDArray[np.float64]
LEAST_FACTOR: Final = 0.01
"""Below which a factor is taken for a slip of the pen: 0 makes another task."""


@dataclass(frozen=True)
class Factor:
    """A property of the model by its factor; 1 is as it is.

    Attributes:
        what: it is, for tables: ``friction of all contacts``.
        low: below which no policy could solve the task, or nothing is simulated.
        high: above which, likewise.
        why: they are the limits.
    """

    what: str
    low: float = LEAST_FACTOR
    high: float = 100.0
    why: str = "another task begins there"


@dataclass(frozen=True)
class Box:
    """Where a thing stands at the start of an episode, drawn uniformly.

    Where it stands is told by k numbers, which are what begins an episode unless ``placed`` says
    otherwise: two angles, of which an orientation is made.

    Attributes:
        key: of the tensordict that begins an episode (`Task.starts`).
        low: corner [k].
        high: the corner opposite.
        names: of the axes, for settings: ``door_x``; "" for one that stays as it is.
        least: corner beyond which no policy could solve the task, [k].
        most: the corner opposite.
        why: these are the limits.
        unit: of all.
        placed: what begins an episode [..., p], of numbers of the box [..., k]; None: the same.
        numbers: the other way round.
        beyond: distances from an edge at which `make robust` lets things stand; None: its own.
    """

    key: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    names: tuple[str, ...]
    least: tuple[float, ...]
    most: tuple[float, ...]
    why: str
    unit: str = "m"
    placed: Callable[[Floats], Floats] | None = None
    numbers: Callable[[Floats], Floats] | None = None
    beyond: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if (self.placed is None) != (self.numbers is None):
            raise ValueError(f"{self.key}: placed and numbers are given together")


@dataclass(frozen=True)
class Disturb:
    """What of a task can be disturbed.

    Attributes:
        apply: gives one copy of an environment these factors, by name, from its next reset on;
            those that are not named are 1.
        factors: by name.
        boxes: where things stand.
        rest: the action [A] of a hand that is left alone, which a delay begins with; None is 0.
    """

    apply: Callable[[EnvBase, int, Mapping[str, float]], None]
    factors: Mapping[str, Factor]
    boxes: tuple[Box, ...] = ()
    rest: Callable[[], NDArray[np.float32]] | None = None

    def axis(self, name: str) -> tuple[Box, int]:
        """The box and the axis that a setting names.

        Raises:
            ValueError: none is called so.
        """
        for box in self.boxes:
            if name in box.names:
                return box, box.names.index(name)
        known = sorted(n for box in self.boxes for n in box.names if n)
        raise ValueError(f"{name} is no place of this task; it has {known or 'none'}")


@dataclass(frozen=True)
class Disturbance:
    """What disturbs an episode: a value of each is drawn at its start, low = high is fixed.

    Attributes:
        observation_noise: standard deviation of normal noise on every entry of an observation.
        action_noise: likewise, of an action in [-1, 1], which is cut back to these bounds.
        delay: control steps until an action is played.
        factors: of the model, by name; drawn uniformly in their logarithm.
        outside: how far beyond the edges of its box a thing may stand, by the axis' name: from
            ``low`` (negative: below the lower edge) to ``high`` (above the upper one).
    """

    observation_noise: Range = (0.0, 0.0)
    action_noise: Range = (0.0, 0.0)
    delay: tuple[int, int] = (0, 0)
    factors: Mapping[str, Range] = field(default_factory=dict)
    outside: Mapping[str, Range] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether it disturbs anything."""
        return self != Disturbance()

    def require(self, disturb: Disturb | None, task: str, key: str) -> None:
        """Look for what the task does not know, or nobody could solve.

        Args:
            disturb: Of the task.
            task: Its name.
            key: Before the names of settings, for messages.

        Raises:
            ValueError: A setting is unknown, empty or refused.
        """
        for name in ("observation_noise", "action_noise", "delay"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise ValueError(
                    f"{key}{name}=[{low}, {high}] must be a range of numbers that are not negative"
                )
        if disturb is None:
            asked = [f"factors.{n}" for n in self.factors] + [f"outside.{n}" for n in self.outside]
            if asked:
                raise ValueError(
                    f"{key}{asked[0]} needs a task that says what of it can be disturbed, and task "
                    f"{task} does not: leave it out, or give the task its `disturb` (envs/task.py)"
                )
            return
        for name, span in self.factors.items():
            _require_factor(disturb, name, span, f"{key}factors.{name}")
        for name, span in self.outside.items():
            _require_place(disturb, name, span, f"{key}outside.{name}")


def _require_factor(disturb: Disturb, name: str, span: Range, key: str) -> None:
    if name not in disturb.factors:
        raise ValueError(f"{key} is unknown; this task has {sorted(disturb.factors)}")
    factor = disturb.factors[name]
    _require_within(span, (factor.low, factor.high), key, factor.why)


def _require_place(disturb: Disturb, name: str, span: Range, key: str) -> None:
    try:
        box, axis = disturb.axis(name)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    # How far beyond each edge a thing can stand; rounded, since 0.252 - 0.252 may be -5e-17.
    room = (
        round(box.least[axis] - box.low[axis], 9),
        round(box.most[axis] - box.high[axis], 9),
    )
    _require_within(span, room, key, box.why)


def _require_within(span: Range, limits: Range, key: str, why: str) -> None:
    low, high = span
    if not low <= high:
        raise ValueError(f"{key}=[{low}, {high}] is not a range: the lower number comes first")
    if low < limits[0] or high > limits[1]:
        raise ValueError(
            f"{key}=[{low}, {high}] is outside [{limits[0]}, {limits[1]}], and no policy could be "
            f"blamed for failing: {why}"
        )
