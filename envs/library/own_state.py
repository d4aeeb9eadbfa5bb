"""What an environment or its wrappers offer as their state: ``get_state`` and ``set_state``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium
from numpy.typing import NDArray

from envs.library.layers import layers
from envs.library.plain import as_arrays, like
from envs.one_line import kind_and_text

Array = NDArray[Any]
Env = gymnasium.Env[Any, Any]


class OwnStateError(RuntimeError):
    """``get_state`` or ``set_state`` of somebody's environment does not do; one line says why."""


def offers_state(env: Env) -> bool:
    """Whether ``env``, or a wrapper of it, offers ``get_state()`` and ``set_state(state)``."""
    return bool(_offering(env))


def _offering(env: Env) -> dict[int, Any]:
    """What offers a state of its own, by its depth in the wrappers."""
    return {depth: layer for depth, layer in enumerate(layers(env)) if _offers(layer)}


def _offers(layer: Any) -> bool:
    get, put = getattr(layer, "get_state", None), getattr(layer, "set_state", None)
    return _takes(get) and _takes(put, None)


def _takes(function: Any, *arguments: Any) -> bool:
    """Whether it can be called so; gymnasium's `MujocoEnv` has a ``set_state`` of two arguments."""
    try:
        inspect.signature(function).bind(*arguments)
    except (TypeError, ValueError):
        return False
    return True


def own_state(env: Env) -> dict[str, Array]:
    """What ``get_state`` gives, as arrays.

    Raises:
        OwnStateError: it raised, or gave what no checkpoint can hold.
    """
    state: dict[str, Array] = {}
    for depth, layer in _offering(env).items():
        try:
            own = as_arrays(layer.get_state())
        # Whatever somebody's method raises is told in one line.
        except Exception as error:
            raise _failed("get_state()", error) from error
        state |= {f"own/{depth}/{key}": array for key, array in own.items()}
    return state


def set_own_state(env: Env, state: Mapping[str, Array]) -> None:
    """Hands ``set_state`` what :func:`own_state` gave.

    Raises:
        OwnStateError: it raised, or the environment offers other entries than then.
    """
    # From the inside out: a wrapper may look at what it is wrapped around.
    for depth, layer in reversed(_offering(env).items()):
        try:
            template, saved = layer.get_state(), under(f"own/{depth}/", state)
            if missing := saved.keys() ^ as_arrays(template).keys():
                raise LookupError(f"get_state() gives {min(missing)!r} at some times only")
            layer.set_state(like(template, saved))
        except Exception as error:
            raise _failed("set_state()", error) from error


def _failed(name: str, error: Exception) -> OwnStateError:
    return OwnStateError(f"{name} failed ({kind_and_text(error)})")


def under(prefix: str, state: Mapping[str, Array]) -> dict[str, Array]:
    """The entries below ``prefix``, without it."""
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
