"""Weights of the imitation term as functions of the number of updates.

A schedule is any callable ``updates -> weight``. Those here are frozen dataclasses: they compare,
print and hash by their settings, and hold no counter, so a resumed run needs to restore nothing
but the number of updates. Constructors raise ``ValueError`` on settings that make no sense.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Protocol


class Schedule(Protocol):
    """A weight that depends on the number of updates done so far."""

    def __call__(self, updates: int) -> float:
        """Return the weight for the update that follows ``updates`` completed ones."""


@dataclass(frozen=True)
class ConstantWeight:
    """The same weight at every update: lambda of BC-SAC (section III-C).

    Attributes:
        init: the weight at every update, >= 0.
    """

    init: float

    def __post_init__(self) -> None:
        """Validate the settings."""
        _require_weights(init=self.init)

    def __call__(self, updates: int) -> float:
        """Return ``init``, whatever ``updates`` is."""
        return self.init


@dataclass(frozen=True)
class ExponentialWeight:
    """``lambda_0 alpha^n`` of DBC-SAC (section III-D); the paper runs lambda_0 = 1, alpha = 0.999.

    Attributes:
        init: lambda_0 >= 0, the weight of the first update.
        decay: alpha in [0, 1], the factor per update.
    """

    init: float
    decay: float

    def __post_init__(self) -> None:
        """Validate the settings."""
        _require_weights(init=self.init)
        if not 0.0 <= self.decay <= 1.0:
            raise ValueError(f"decay is a factor per update in [0, 1], got {self.decay}")

    def __call__(self, updates: int) -> float:
        """Return ``init * decay ** updates``."""
        return self.init * self.decay**updates


@dataclass(frozen=True)
class LinearWeight:
    """A straight line from ``init`` to ``final`` over ``duration`` updates, then ``final``.

    Attributes:
        init: first weight, >= 0.
        final: last weight, >= 0.
        duration: updates between the two, >= 1.
    """

    init: float
    final: float
    duration: int

    def __post_init__(self) -> None:
        """Validate the settings."""
        _require_weights(init=self.init, final=self.final)
        _require_duration(self.duration)

    def __call__(self, updates: int) -> float:
        """Return the weight after ``updates``."""
        progress = min(updates / self.duration, 1.0)
        # This form, unlike init + (final - init) * progress, ends at `final` exactly.
        return (1.0 - progress) * self.init + progress * self.final


@dataclass(frozen=True)
class CosineWeight:
    """Half a cosine from ``init`` to ``final`` over ``duration`` updates, then ``final``.

    Attributes:
        init: first weight, >= 0.
        final: last weight, >= 0.
        duration: updates between the two, >= 1.
    """

    init: float
    final: float
    duration: int

    def __post_init__(self) -> None:
        """Validate the settings."""
        _require_weights(init=self.init, final=self.final)
        _require_duration(self.duration)

    def __call__(self, updates: int) -> float:
        """Return the weight after ``updates``."""
        progress = (1.0 - math.cos(math.pi * min(updates / self.duration, 1.0))) / 2.0
        return (1.0 - progress) * self.init + progress * self.final


@dataclass(frozen=True)
class PiecewiseWeight:
    """Steps: ``values[k]`` from update ``milestones[k - 1]`` on.

    Attributes:
        milestones: updates at which the weight changes, >= 1 and increasing.
        values: weights >= 0, one more than milestones; the first holds from update 0.
    """

    milestones: tuple[int, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Validate the settings; lists, as configurations give them, become tuples."""
        object.__setattr__(self, "milestones", tuple(self.milestones))
        object.__setattr__(self, "values", tuple(self.values))
        if len(self.values) != len(self.milestones) + 1:
            raise ValueError(
                f"values must be one more than milestones, got {len(self.values)} values "
                f"and {len(self.milestones)} milestones"
            )
        starts = (0, *self.milestones)
        if any(later <= earlier for earlier, later in zip(starts, self.milestones, strict=False)):
            raise ValueError(f"milestones must be >= 1 and increasing, got {self.milestones}")
        _require_weights(**{f"values[{k}]": value for k, value in enumerate(self.values)})

    def __call__(self, updates: int) -> float:
        """Return the weight after ``updates``."""
        return self.values[bisect_right(self.milestones, updates)]


SCHEDULES: Mapping[str, type[Schedule]] = {
    "constant": ConstantWeight,
    "exponential": ExponentialWeight,
    "linear": LinearWeight,
    "cosine": CosineWeight,
    "piecewise": PiecewiseWeight,
}
"""The schedules by the name that a configuration gives them."""


def schedule_kind(schedule: Schedule) -> str:
    """Return the name in :data:`SCHEDULES` of a schedule's class.

    Raises:
        ValueError: for another callable.
    """
    for kind, known in SCHEDULES.items():
        if type(schedule) is known:
            return kind
    raise ValueError(
        f"{schedule!r} is none of {', '.join(c.__name__ for c in SCHEDULES.values())}, which are "
        "the weights that a run can save and go on with: name one of your own by its file, "
        "{kind: my_schedules.py:NAME}"
    )


def setting_names(kind: str) -> tuple[str, ...]:
    """Return the names of the settings of a kind, in their order."""
    return tuple(field.name for field in fields(SCHEDULES[kind]))  # type: ignore[arg-type]


def make_schedule(kind: str, **options: object) -> Schedule:
    """Build a schedule from its name and settings, e.g. ``make_schedule("constant", init=1.0)``.

    Args:
        kind: a key of :data:`SCHEDULES`.
        **options: exactly the attributes of that class.

    Raises:
        ValueError: for an unknown kind, for an unknown or missing option, or for a bad value.
    """
    if kind not in SCHEDULES:
        raise ValueError(f"unknown schedule {kind!r}; choose one of {', '.join(SCHEDULES)}")
    expected = setting_names(kind)
    if set(options) != set(expected):
        raise ValueError(
            f"schedule {kind!r} takes exactly {', '.join(expected)}; "
            f"got {', '.join(options) or 'none'}"
        )
    return SCHEDULES[kind](**options)


def _require_weights(**weights: float) -> None:
    for name, weight in weights.items():
        if not (math.isfinite(weight) and weight >= 0.0):
            raise ValueError(f"{name} is a weight and must be finite and >= 0, got {weight}")


def _require_duration(duration: int) -> None:
    if duration < 1:
        raise ValueError(f"duration counts updates and must be >= 1, got {duration}")
