"""What counts as success and as progress in somebody's environment, and what it is paid."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from envs.library.functions import load_function
from envs.options import TaskOptions

Array = NDArray[Any]
INFO: Final = "info:"
FOUND: Final = ("success", "is_success")
"""Keys of ``info`` that tell success in the environments of others."""
BOUND: Final = re.compile(r"(reward|return)\s*>=\s*(.+)")
SUCCESS_FORMS: Final = "info:KEY, terminated, reward>=X, return>=X, path.py:function"
PROGRESS_FORMS: Final = "info:KEY, path.py:function"


@dataclass(frozen=True)
class Steps:
    """What one step of B copies gave.

    Attributes:
        observation: after it, float32 [B, O].
        reward: float64 [B]; zero at a reset.
        returns: of the episode so far, float64 [B].
        terminated: bool [B].
        info: entries of ``info`` by key, float64 [B], NaN where a copy did not tell.
    """

    observation: Array
    reward: Array
    returns: Array
    terminated: Array
    info: Mapping[str, Array]


@dataclass(frozen=True)
class Signal:
    """A column of every step.

    Attributes:
        measure: gives it, [B].
        info: key of ``info`` that it reads, if it does.
        of_observations: whether it is told from the observations alone, hence in recordings too.
    """

    measure: Callable[[Steps], Array]
    info: str | None = None
    of_observations: Callable[[Array], Array] | None = None


def info_keys(options: TaskOptions) -> dict[str, str]:
    """Keys of ``info`` that options ask for, by the option."""
    asked = {"task.success": options.success, "task.progress": options.progress}
    return {
        option: wanted.removeprefix(INFO)
        for option, wanted in asked.items()
        if wanted is not None and wanted.startswith(INFO)
    }


def success_signal(wanted: str | None, told: frozenset[str]) -> Signal | None:
    """The signal that ``task.success`` asks for.

    Args:
        wanted: the option; None takes what the environment tells by itself.
        told: keys of ``info`` that it was seen to give.

    Raises:
        ValueError: the option has none of the forms.
    """
    if wanted is None:
        key = next((key for key in FOUND if key in told), None)
        return None if key is None else _info_flag(key)
    if wanted.startswith(INFO):
        return _info_flag(wanted.removeprefix(INFO))
    if wanted == "terminated":
        return Signal(lambda steps: steps.terminated)
    if match := BOUND.fullmatch(wanted):
        bound = _number(wanted, match[2])
        if match[1] == "reward":
            return Signal(lambda steps: steps.reward >= bound)
        return Signal(lambda steps: steps.returns >= bound)
    return _of_observations("task.success", wanted, SUCCESS_FORMS, np.bool_)


def progress_signal(wanted: str | None) -> Signal | None:
    """The signal that ``task.progress`` asks for; None if it asks for none.

    Raises:
        ValueError: the option has none of the forms.
    """
    if wanted is None:
        return None
    if wanted.startswith(INFO):
        key = wanted.removeprefix(INFO)
        # Until the environment first tells it, nothing has been achieved.
        return Signal(lambda steps: np.nan_to_num(steps.info[key], nan=0.0), info=key)
    return _of_observations("task.progress", wanted, PROGRESS_FORMS, np.float32)


def reward_function(options: TaskOptions) -> Callable[[Array, Array, Array], Array] | None:
    """The function of ``task.reward``, checked to give one finite number per row.

    Raises:
        ValueError: it cannot be loaded.
    """
    if options.reward is None:
        return None
    asked = f"task.reward={options.reward}"
    function = load_function(
        "task.reward", _named("task.reward", options.reward, "path.py:function")
    )

    def reward(observation: Array, action: Array, following: Array) -> Array:
        return _checked(asked, function(observation, action, following), len(observation))

    return reward


def _info_flag(key: str) -> Signal:
    # Many environments tell it only in an episode's last step: until then, not yet.
    return Signal(lambda steps: np.nan_to_num(steps.info[key], nan=0.0) != 0.0, info=key)


def _of_observations(key: str, wanted: str, forms: str, dtype: type[np.generic]) -> Signal:
    function = load_function(key, _named(key, wanted, forms))

    def measure(observation: Array) -> Array:
        rows = observation.reshape(-1, observation.shape[-1])
        told = _checked(f"{key}={wanted}", function(rows), len(rows)).astype(dtype)
        return told.reshape(observation.shape[:-1])

    return Signal(lambda steps: measure(steps.observation), of_observations=measure)


def _named(key: str, wanted: str, forms: str) -> str:
    if ".py:" not in wanted:
        raise ValueError(f"{key} must be one of {forms}, got {wanted!r}")
    return wanted


def _checked(asked: str, value: Any, rows: int) -> Array:
    found = np.asarray(value)
    if found.shape not in ((rows,), (rows, 1)):
        raise ValueError(
            f"{asked} gave an array of shape {list(found.shape)} for {rows} rows; expected [{rows}]"
        )
    return found.reshape(rows)


def _number(wanted: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"task.success={wanted}: {text!r} is not a number") from None
