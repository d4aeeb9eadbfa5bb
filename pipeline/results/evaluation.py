"""An evaluation: the content of ``evaluation.json``, checked as soon as it is read.

Readers use attributes for what every task tells, and :meth:`Evaluation.figure` for a number under
any key, such as the door's ``share_gt_1_35``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Final, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError

MOST_EPISODES: Final = 10**7
"""An interval over episodes takes a number for each."""
SHOWN: Final = 40
"""Characters of a wrong value in a message."""
FORMER: Final[Mapping[str, str]] = MappingProxyType(
    {"steps_to_success_median": "steps_to_open_median"}
)
"""What evaluations of the door called a figure before every task had it."""

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Spread = Annotated[list[float], Field(min_length=3, max_length=3)]
"""10, 50 and 90 % quantile over episodes."""
Numbers = dict[str, float]


class _Object(BaseModel):
    """Null is as good as absent where a field says so; under other keys stands anything."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    @classmethod
    def of(cls, content: Any) -> Self:
        """What a file holds.

        Raises:
            ValueError: It is something that no reader could use; the message names key and value.
        """
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            raise ValueError(first_fault(error)) from error


class Movement(_Object):
    """How a set of movements goes (docs/metrics.md)."""

    path_distance: Spread | None = None
    posture_distance: Spread | None = None
    steps: Spread | None = None
    speed_mean: Spread | None = None
    jerk_mean: Spread | None = None
    log_dimensionless_jerk: Spread | None = None
    saturated_actions: Spread | None = None


class Likeness(Movement):
    """Of a policy's movements to demonstrations."""

    to: str
    of_demonstrations: Movement


class Strategies(_Object):
    """How a policy goes about its task: shares of the episodes by way."""

    words: dict[str, str]
    shares: Numbers
    thresholds: Numbers = Field(default_factory=dict)
    sensitivity: dict[str, dict[str, Numbers]] = Field(default_factory=dict)
    progress_at_last_contact: Spread | None = None
    travel_untouched_mean: float | None = None
    kept_at_end: dict[str, float | None] | None = None
    lost_at_end: Share | None = None


class Versions(_Object):
    """Of packages, machine and sources."""

    git: str | None = None
    git_dirty: bool | None = None
    machine: str | None = None
    packages: dict[str, str | None] | None = None


class MadeFrom(_Object):
    """What figures of a policy were made from: the run, its budget, seeds and versions."""

    run: str
    variant: str
    seed: int
    checkpoint: str | None = None
    task: str | None = None
    env: str | None = None
    reward: str | None = None
    preset: str | None = None
    demos: str | None = None
    demos_sha256: str | None = None
    demos_multiplied: bool | None = None
    exploration: str | None = None
    precision: str | None = None
    bc_weight: float | None = None
    noise_scale: float | None = None
    evaluation_seed: int | None = None
    frames: int | None = None
    simulator_steps: int | None = None
    overrides: list[str] | None = None
    versions: Versions | None = None

    @property
    def task_name(self) -> str | None:
        """The task, also where it was called the environment."""
        return self.env if self.task is None else self.task


class Evaluation(_Object):
    """Figures of a policy over the episodes of its task's list (docs/metrics.md).

    A task tells figures of its own beside these, under keys of its own.
    """

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    made_from: MadeFrom
    return_mean: float | None = None
    return_std: float | None = None
    length_mean: float | None = None
    steps_to_success_median: float | None = None
    progress_max_mean: float | None = None
    success_once: Share | None = None
    success_at_end: Share | None = None
    success_share: Share | None = None
    stages: Numbers | None = None
    likeness: Likeness | None = None
    strategies: Strategies | None = None
    _content: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, content: Any) -> Self:
        """See above; numbers under keys of the task's own are finite too."""
        for fault in _not_finite(content, ""):
            raise ValueError(fault)
        found = super().of(content)
        found._content = content
        return found

    @property
    def content(self) -> Mapping[str, Any]:
        """Everything that the file holds, in its order."""
        return self._content

    def figure(self, key: str) -> float | None:
        """The number under a key; None where the task does not tell it.

        Raises:
            ValueError: What stands there is no number; the message names run, key and value.
        """
        value = self._content.get(key, self._content.get(FORMER.get(key, key)))
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(
                f"{self.made_from.run}: its evaluation's {key} is {repr(value)[:SHOWN]}, expected "
                "a number; make it again with: make eval"
            )
        return float(value)


def first_fault(error: ValidationError) -> str:
    """The first thing that is wrong, in one line."""
    first = error.errors(include_url=False)[0]
    key = ".".join(map(str, first["loc"]))
    if first["type"] == "missing":
        return f"it has no {key}"
    expected = first["msg"].partition(" or instance of")[0]  # a class of ours
    return f"{f'its {key}' if key else 'it'} is {repr(first['input'])[:SHOWN]}: {expected}"


def _not_finite(value: Any, key: str) -> Iterator[str]:
    """Numbers under any key that are not finite as a float: JSON knows no limit, Python no rule."""
    if isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _not_finite(entry, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for entry in value:
            yield from _not_finite(entry, key)
    elif isinstance(value, int) and abs(value) > sys.float_info.max:
        yield f"its {key} is too large for a float, expected a finite number"
    elif isinstance(value, float) and not math.isfinite(value):
        yield f"its {key} is {value}, expected a finite number"
