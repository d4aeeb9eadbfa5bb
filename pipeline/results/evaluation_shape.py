"""What kind of value an evaluation holds under which key: all that its readers rely on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final, Self, TypeGuard

MOST_EPISODES: Final = 10**7
"""An interval over episodes takes a number for each."""
SHOWN: Final = 40
"""Characters of a wrong value in a message."""


@dataclass(frozen=True)
class Value:
    """A number, a text or a list of them.

    Attributes:
        words: what it is.
        fits: whether a value is one.
    """

    words: str
    fits: Callable[[Any], bool]

    def faults(self, value: Any, key: str) -> Iterator[str]:
        """What is wrong with ``value``, by the dotted ``key`` it stands under."""
        if not self.fits(value):
            yield f"its {key} is {repr(value)[:SHOWN]}, expected {self.words}"


@dataclass(frozen=True)
class Fields:
    """An object.

    Attributes:
        named: what stands under these keys; null is as good as absent.
        others: what stands under all others; None is anything.
        required: keys that cannot be absent.
    """

    named: Mapping[str, Value | Self] = field(default_factory=dict)
    others: Value | Self | None = None
    required: tuple[str, ...] = ()

    def faults(self, value: Any, key: str = "") -> Iterator[str]:
        """As :meth:`Value.faults`."""
        if not isinstance(value, Mapping):
            yield f"its {key} is {repr(value)[:SHOWN]}, expected an object"
            return
        prefix = f"{key}." if key else ""
        for name in self.required:
            if value.get(name) is None:
                yield f"it has no {prefix}{name}"
        for name, entry in value.items():
            kind = self.named.get(name, self.others)
            if kind is not None and (entry is not None or name not in self.named):
                yield from kind.faults(entry, f"{prefix}{name}")


def is_number(value: Any) -> TypeGuard[float]:
    """Whether it is a number of JSON that stays finite as a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _is_whole(value: Any) -> bool:
    return is_number(value) and isinstance(value, int)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


NUMBER: Final = Value("a number", is_number)
SHARE: Final = Value("a number in [0, 1]", lambda value: is_number(value) and 0 <= value <= 1)
WHOLE: Final = Value("a whole number", _is_whole)
EPISODES: Final = Value(
    f"a whole number from 1 to {MOST_EPISODES}",
    lambda value: _is_whole(value) and 1 <= value <= MOST_EPISODES,
)
TEXT: Final = Value("a text", _is_text)
TEXT_OR_NULL: Final = Value("a text", lambda value: value is None or _is_text(value))
TEXTS: Final = Value(
    "a list of texts", lambda value: isinstance(value, list) and all(map(_is_text, value))
)
SPREAD: Final = Value(
    "a list of three numbers",
    lambda value: isinstance(value, list) and len(value) == 3 and all(map(is_number, value)),
)
LIKENESS: Final = dict.fromkeys(
    (
        "path_distance", "posture_distance", "steps", "speed_mean", "jerk_mean",
        "log_dimensionless_jerk", "saturated_actions",
    ),
    SPREAD,
)  # fmt: skip

EVALUATION: Final = Fields(
    {
        "episodes": EPISODES,
        **dict.fromkeys(("return_mean", "return_std", "length_mean"), NUMBER),
        **dict.fromkeys(("steps_to_success_median", "progress_max_mean"), NUMBER),
        **dict.fromkeys(("success_once", "success_at_end", "success_share"), SHARE),
        "stages": Fields(others=NUMBER),
        "likeness": Fields(
            {"to": TEXT, "of_demonstrations": Fields(LIKENESS), **LIKENESS},
            required=("to", "of_demonstrations"),
        ),
        "strategies": Fields(
            {
                "words": Fields(others=TEXT),
                "shares": Fields(others=NUMBER),
                "thresholds": Fields(others=NUMBER),
                "sensitivity": Fields(others=Fields(others=Fields(others=NUMBER))),
                "progress_at_last_contact": SPREAD,
                "travel_untouched_mean": NUMBER,
            },
            required=("words", "shares", "thresholds", "sensitivity"),
        ),
        "made_from": Fields(
            {
                **dict.fromkeys(("run", "checkpoint", "task", "env", "reward", "variant"), TEXT),
                **dict.fromkeys(("preset", "demos", "demos_sha256", "exploration"), TEXT),
                **dict.fromkeys(("bc_weight", "noise_scale"), NUMBER),
                **dict.fromkeys(("seed", "evaluation_seed", "frames", "simulator_steps"), WHOLE),
                "overrides": TEXTS,
                "versions": Fields(
                    {"git": TEXT, "machine": TEXT, "packages": Fields(others=TEXT_OR_NULL)},
                ),
            },
            required=("run", "variant", "seed"),
        ),
    },
    required=("episodes", "made_from"),
)
"""Figures of a task's own are whatever it tells; those of its tables are looked at there."""


def require_evaluation(content: Any) -> None:
    """Raises a ValueError that names the first key with a value that no reader could use."""
    for fault in chain(_unusable(content, ""), EVALUATION.faults(content)):
        raise ValueError(fault)


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
