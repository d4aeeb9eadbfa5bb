"""The whole state of an environment, so that an episode can go on after a restart.

It is what a MuJoCo simulation holds, or the array ``state`` of gymnasium's classic control, and
what the environment or its wrappers offer themselves (``get_state()`` and ``set_state(state)``);
besides, its generator of random numbers and the steps that time limits have counted.

Only environments for which that is seen to work (:func:`continues_exactly`) are continued: whatever
else one keeps in Python would be missing from the state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from envs.library.layers import layers
from envs.library.mujoco_state import mujoco_of, mujoco_state, set_mujoco_state
from envs.library.own_state import OwnStateError, offers_state, own_state, set_own_state, under
from envs.library.plain import as_arrays, like

Array = NDArray[Any]
Env = gymnasium.Env[Any, Any]

STEPS: Final = 12
"""Steps before and after a restored state for it to count as whole."""
COUNTERS: Final = ("_step_count", "_reset_next_step")
"""dm_control's own place in an episode."""
CLASSIC: Final = "gymnasium.envs.classic_control."
"""Modules of environments that keep nothing between steps but their array ``state``."""


def save_state(env: Env) -> dict[str, Array]:
    """What :func:`restore_state` needs, as arrays.

    Raises:
        OwnStateError: ``get_state`` raised, or gave what no checkpoint can hold.
    """
    state: dict[str, Array] = {}
    if mujoco_of(env) is not None:
        state |= mujoco_state(env)
    if _is_classic(env):
        state |= _classic_state(env)
    state |= own_state(env)
    # The kind of the generator is that of the environment, and no part of the state.
    drawn = {key: value for key, value in _random_state(env).items() if key != "bit_generator"}
    state |= {f"random/{key}": array for key, array in as_arrays(drawn).items()}
    return state | {f"counter/{key}": np.asarray(n) for key, (_, n) in _counters(env).items()}


def require_same(one: Mapping[str, Array], other: Mapping[str, Array]) -> None:
    """Refuses states of two copies that cannot be stacked.

    Raises:
        OwnStateError: they differ in a name or a shape.
    """
    for key in sorted(one.keys() | other.keys()):
        if key not in one or key not in other or one[key].shape != other[key].shape:
            raise OwnStateError(
                f"get_state() gave {key.rpartition('/')[2]!r} in another shape than another copy's"
            )


def restore_state(env: Env, state: Mapping[str, Array]) -> None:
    """Continue from what :func:`save_state` gave.

    Raises:
        OwnStateError: ``set_state`` raised.
    """
    # Wrappers that count or check the order of calls begin an episode.
    env.reset()
    if mujoco_of(env) is not None:
        set_mujoco_state(env, state)
    if _is_classic(env):
        _set_classic_state(env, state)
    set_own_state(env, state)
    _set_random_state(env, like(_random_state(env), under("random/", state)))
    for key, (holder, _) in _counters(env).items():
        setattr(holder, key.rpartition("/")[2], state[f"counter/{key}"].item())


def continues_exactly(env: Env) -> bool:
    """Whether a restored state goes on bit for bit, random draws included: by trying it.

    An episode is saved midway and played on, with another begun behind it; the same is played again
    from the saved state, restored in the midst of an episode of another seed.

    Raises:
        OwnStateError: as :func:`save_state` and :func:`restore_state`.
    """
    if not (offers_state(env) or mujoco_of(env) is not None or _is_classic(env)):
        return False
    if not _has_random_state(env):
        return False
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(STEPS)]
    env.reset(seed=1)
    _play(env, actions)
    saved = save_state(env)
    expected = _play(env, actions, then_reset=True)
    env.reset(seed=2)
    _play(env, actions[::-1])
    restore_state(env, saved)
    return _play(env, actions, then_reset=True) == expected


def _play(env: Env, actions: list[Any], *, then_reset: bool = False) -> list[bytes]:
    """What ``actions`` show and pay; an episode that ends is followed by another."""
    seen: list[bytes] = []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append(_numbers(env, observation).tobytes())
        seen.append(np.array([reward, terminated, truncated]).tobytes())
        if terminated or truncated:
            seen.append(_numbers(env, env.reset()[0]).tobytes())
    if then_reset:
        seen.append(_numbers(env, env.reset()[0]).tobytes())
    return seen


def _numbers(env: Env, observation: Any) -> Array:
    return np.asarray(gymnasium.spaces.flatten(env.observation_space, observation))


def _counters(env: Env) -> dict[str, tuple[Any, int]]:
    found: dict[str, tuple[Any, int]] = {}
    for depth, layer in enumerate(layers(env)):
        if isinstance(layer, TimeLimit):
            found[f"{depth}/_elapsed_steps"] = (layer, layer._elapsed_steps or 0)
    suite = getattr(env.unwrapped, "_env", None)
    for name in COUNTERS:
        if suite is not None and hasattr(suite, name):
            found[f"suite/{name}"] = (suite, getattr(suite, name))
    return found


def _is_classic(env: Env) -> bool:
    return type(env.unwrapped).__module__.startswith(CLASSIC)


def _classic_state(env: Env) -> dict[str, Array]:
    inner: Any = env.unwrapped
    values = np.asarray(inner.state)
    # Some begin with float64 and go on with float32.
    single = np.asarray(values.dtype == np.float32)
    return {"classic/state": values.astype(np.float64), "classic/single": single}


def _set_classic_state(env: Env, state: Mapping[str, Array]) -> None:
    inner: Any = env.unwrapped
    kind = np.float32 if state["classic/single"] else np.float64
    inner.state = state["classic/state"].astype(kind)


def _generators(env: Env) -> Any:
    return getattr(env.unwrapped, "np_random", None)


def _has_random_state(env: Env) -> bool:
    return isinstance(_generators(env), np.random.Generator | np.random.RandomState)


def _random_state(env: Env) -> dict[str, Any]:
    random = _generators(env)
    state: dict[str, Any] = (
        random.get_state(legacy=False)
        if isinstance(random, np.random.RandomState)
        else random.bit_generator.state
    )
    return state


def _set_random_state(env: Env, state: dict[str, Any]) -> None:
    random = _generators(env)
    if isinstance(random, np.random.RandomState):
        random.set_state(state)
    else:
        random.bit_generator.state = state
