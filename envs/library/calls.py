"""Calls of somebody's environment, and what they give held against gymnasium's API."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import gymnasium
import numpy as np

Env = gymnasium.Env[Any, Any]
Stepped = tuple[Any, Any, bool, bool, Mapping[str, Any]]
EXPECTED: Final = (
    "gymnasium's API is expected: reset(seed=) -> observation, info; step() -> observation, "
    "reward, terminated, truncated, info (for environments of the old gym, shimmy has wrappers)"
)
OLD: Final = re.compile(r"values to unpack \(expected [25]|unexpected keyword argument 'seed'")
"""What gymnasium's own wrappers, and Python, say of an environment of the old gym."""


class OtherApiError(TypeError):
    """An environment takes or returns something else than gymnasium's do; one line says what."""


def reset(env: Env, **options: Any) -> tuple[Any, Mapping[str, Any]]:
    """Observation and ``info`` of ``env.reset``.

    Raises:
        OtherApiError: it gives something else, or takes no seed.
    """
    result = _called(lambda: env.reset(**options), "reset")
    if not _holds(result, 2):
        raise OtherApiError(f"reset() returned {_kind(result)}: {EXPECTED}")
    return result[0], result[1]


def step(env: Env, action: Any) -> Stepped:
    """The five values of ``env.step``, the flags as bool.

    Raises:
        OtherApiError: it gives something else, or flags that are neither true nor false.
    """
    result = _called(lambda: env.step(action), "step")
    if not _holds(result, 5):
        raise OtherApiError(f"step() returned {_kind(result)}: {EXPECTED}")
    observation, reward, terminated, truncated, info = result
    flags = _flag("terminated", terminated), _flag("truncated", truncated)
    return observation, reward, *flags, info


def _called(use: Any, name: str) -> Any:
    try:
        return use()
    except SystemExit as error:  # it would end the run as one that is complete
        raise RuntimeError(f"sys.exit({error.code!r}) was called") from error
    except (TypeError, ValueError) as error:
        if OLD.search(str(error)) is None:
            raise
        raise OtherApiError(f"{name}() failed ({error}): {EXPECTED}") from error


def _holds(result: Any, count: int) -> bool:
    return isinstance(result, tuple) and len(result) == count and isinstance(result[-1], Mapping)


def _kind(result: Any) -> str:
    if not isinstance(result, tuple):
        return f"one value ({type(result).__name__})"
    return f"{len(result)} values ({', '.join(type(entry).__name__ for entry in result)})"


def _flag(name: str, value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    array = np.asarray(value)
    # NaN is neither.
    if array.size != 1 or array.dtype.kind not in "biuf" or array.item() not in (0, 1):
        told = " ".join(repr(value).split())
        raise OtherApiError(f"step() returned {name}={told:.40}, expected True or False")
    return bool(array.item())
