"""What kind of value an evaluation holds under which key: all that its readers rely on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, TypeGuard

from pydantic import BaseModel, ConfigDict, Field, ValidationError

MOST_EPISODES: Final = 10**7
"""An interval over episodes takes a number for each."""
SHOWN: Final = 40
"""Characters of a wrong value in a message."""

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Spread = Annotated[list[float], Field(min_length=3, max_length=3)]
Numbers = dict[str, float]


class _Object(BaseModel):
    """Null is as good as absent where a field says so; under other keys stands anything."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class _Movement(_Object):
    path_distance: Spread | None = None
    posture_distance: Spread | None = None
    steps: Spread | None = None
    speed_mean: Spread | None = None
    jerk_mean: Spread | None = None
    log_dimensionless_jerk: Spread | None = None
    saturated_actions: Spread | None = None


class _Likeness(_Movement):
    to: str
    of_demonstrations: _Movement


class _Strategies(_Object):
    words: dict[str, str]
    shares: Numbers
    thresholds: Numbers
    sensitivity: dict[str, dict[str, Numbers]]
    progress_at_last_contact: Spread | None = None
    travel_untouched_mean: float | None = None
    kept_at_end: dict[str, float | None] | None = None
    lost_at_end: Share | None = None


class _Versions(_Object):
    git: str | None = None
    machine: str | None = None
    packages: dict[str, str | None] | None = None


class _MadeFrom(_Object):
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
    exploration: str | None = None
    bc_weight: float | None = None
    noise_scale: float | None = None
    evaluation_seed: int | None = None
    frames: int | None = None
    simulator_steps: int | None = None
    overrides: list[str] | None = None
    versions: _Versions | None = None


class _Evaluation(_Object):
    """Figures of a task's own are whatever it tells; those of its tables are looked at there."""

    episodes: Annotated[int, Field(ge=1, le=MOST_EPISODES)]
    made_from: _MadeFrom
    return_mean: float | None = None
    return_std: float | None = None
    length_mean: float | None = None
    steps_to_success_median: float | None = None
    progress_max_mean: float | None = None
    success_once: Share | None = None
    success_at_end: Share | None = None
    success_share: Share | None = None
    stages: Numbers | None = None
    likeness: _Likeness | None = None
    strategies: _Strategies | None = None


def is_number(value: Any) -> TypeGuard[float]:
    """Whether it is a number of JSON that stays finite as a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def require_evaluation(content: Any) -> None:
    """Raises a ValueError that names the first key with a value that no reader could use."""
    for fault in _unusable(content, ""):
        raise ValueError(fault)
    try:
        _Evaluation.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            raise ValueError(f"it has no {key}") from error
        expected = first["msg"].partition(" or instance of")[0]  # a class of ours
        raise ValueError(f"its {key} is {repr(first['input'])[:SHOWN]}: {expected}") from error


def _unusable(value: Any, key: str) -> Iterator[str]:
    """Numbers, however deep, that are not finite as a float."""
    if isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _unusable(entry, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for entry in value:
            yield from _unusable(entry, key)
    elif isinstance(value, (int, float)) and not isinstance(value, bool) and not is_number(value):
        told = "too large for a float" if isinstance(value, int) else f"{value}"
        yield f"its {key} is {told}, expected a finite number"
