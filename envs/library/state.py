"""The whole state of a MuJoCo environment, so that an episode can go on after a restart.

Only environments for which that is seen to work (:func:`continues_exactly`) are continued: whatever
else one keeps in Python would be missing from the state.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import gymnasium
import mujoco
import numpy as np
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from envs.library.layers import layers

Array = NDArray[Any]
Env = gymnasium.Env[Any, Any]

INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION
MODEL_FIELDS: Final = (
    *("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat"),
    *("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_rgba"),
    *("site_pos", "site_quat", "site_size", "jnt_range", "dof_damping", "dof_armature"),
    *("dof_frictionloss", "actuator_gainprm", "actuator_biasprm", "qpos0"),
)
"""What environments are known to change of their model when an episode begins."""
DATA_FIELDS: Final = (
    *("xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat"),
    *(
        "site_xpos",
        "site_xmat",
        "cam_xpos",
        "cam_xmat",
        "subtree_com",
        "cdof",
        "cdof_dot",
        "cinert",
    ),
    *("cvel", "cacc", "cfrc_int", "cfrc_ext", "subtree_linvel", "subtree_angmom", "sensordata"),
    *("actuator_length", "actuator_velocity", "actuator_force", "act_dot", "ten_length"),
    *("ten_velocity", "qacc", "qacc_smooth", "qfrc_bias", "qfrc_passive", "qfrc_actuator"),
    *("qfrc_smooth", "qfrc_constraint", "qfrc_inverse"),
)
"""What follows from the state, but as of the last step: observations and rewards may read it."""
STEPS: Final = 12
"""Steps before and after a restored state for it to count as whole."""
COUNTERS: Final = ("_step_count", "_reset_next_step")
"""dm_control's own place in an episode."""


def mujoco_of(env: Env) -> tuple[mujoco.MjModel, mujoco.MjData] | None:
    """Model and data of ``env``; None if it is no MuJoCo environment that shows them."""
    inner: Any = env.unwrapped
    physics = getattr(inner, "physics", None)
    found = [
        getattr(holder, "ptr", holder)
        for holder in (
            getattr(physics or inner, "model", None),
            getattr(physics or inner, "data", None),
        )
    ]
    model, data = found
    if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
        return model, data
    return None


def save_state(env: Env) -> dict[str, Array]:
    """What :func:`restore_state` needs, as arrays."""
    found = mujoco_of(env)
    assert found is not None
    model, data = found
    physics = np.empty(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, physics, INTEGRATION)
    state = {"physics": physics}
    state |= {f"model/{name}": getattr(model, name).copy() for name in MODEL_FIELDS}
    state |= {f"data/{name}": getattr(data, name).copy() for name in DATA_FIELDS}
    state |= {f"random/{key}": array for key, array in _random_state(env).items()}
    return state | {f"counter/{key}": np.asarray(n) for key, (_, n) in _counters(env).items()}


def restore_state(env: Env, state: Mapping[str, Array]) -> None:
    """Continue from what :func:`save_state` gave."""
    found = mujoco_of(env)
    assert found is not None
    # Wrappers that count or check the order of calls begin an episode.
    env.reset()
    model, data = found
    for name in MODEL_FIELDS:
        getattr(model, name)[...] = state[f"model/{name}"]
    mujoco.mj_setState(model, data, state["physics"], INTEGRATION)
    mujoco.mj_forward(model, data)
    # Forward dynamics moved the solver's warm start.
    mujoco.mj_setState(model, data, state["physics"], INTEGRATION)
    for name in DATA_FIELDS:
        getattr(data, name)[...] = state[f"data/{name}"]
    _set_random_state(env, state)
    for key, (holder, _) in _counters(env).items():
        setattr(holder, key.rpartition("/")[2], state[f"counter/{key}"].item())


def continues_exactly(env: Env) -> bool:
    """Whether a restored state goes on bit for bit, random draws included: by trying it.

    An episode is saved midway and played on, with another begun behind it; the same is played again
    from the saved state, restored in the midst of an episode of another seed.
    """
    if mujoco_of(env) is None or not _has_random_state(env):
        return False
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(STEPS)]
    env.reset(seed=1)
    for action in actions:
        env.step(action)
    saved = save_state(env)
    expected = _play(env, actions)
    env.reset(seed=2)
    for action in actions[::-1]:
        env.step(action)
    restore_state(env, saved)
    return _play(env, actions) == expected


def _play(env: Env, actions: list[Any]) -> list[bytes]:
    seen: list[bytes] = []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen.append(_numbers(env, observation).tobytes())
        seen.append(np.array([reward, terminated, truncated]).tobytes())
    observation, _ = env.reset()
    seen.append(_numbers(env, observation).tobytes())
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


def _generators(env: Env) -> Any:
    return getattr(env.unwrapped, "np_random", None)


def _has_random_state(env: Env) -> bool:
    return isinstance(_generators(env), np.random.Generator | np.random.RandomState)


def _random_state(env: Env) -> dict[str, Array]:
    random = _generators(env)
    state = (
        random.get_state(legacy=False)
        if isinstance(random, np.random.RandomState)
        else random.bit_generator.state
    )
    return dict(_as_arrays(state, ""))


def _as_arrays(state: Mapping[str, Any], at: str) -> Iterator[tuple[str, Array]]:
    for key, value in state.items():
        if isinstance(value, Mapping):
            yield from _as_arrays(value, f"{at}{key}.")
        elif isinstance(value, np.ndarray):
            yield f"{at}{key}", value.copy()
        elif isinstance(value, int):
            # PCG64 counts in 128 bits.
            yield f"{at}{key}", np.frombuffer(value.to_bytes(16, "little"), np.uint8).copy()
        elif isinstance(value, float):
            yield f"{at}{key}", np.asarray(value)


def _set_random_state(env: Env, saved: Mapping[str, Array]) -> None:
    random = _generators(env)
    if isinstance(random, np.random.RandomState):
        random.set_state(_filled(random.get_state(legacy=False), saved, ""))
    else:
        random.bit_generator.state = _filled(random.bit_generator.state, saved, "")


def _filled(state: Mapping[str, Any], saved: Mapping[str, Array], at: str) -> dict[str, Any]:
    filled: dict[str, Any] = {}
    for key, value in state.items():
        if isinstance(value, Mapping):
            filled[key] = _filled(value, saved, f"{at}{key}.")
        elif isinstance(value, int):
            filled[key] = int.from_bytes(saved[f"random/{at}{key}"].tobytes(), "little")
        elif isinstance(value, np.ndarray | float):
            array = saved[f"random/{at}{key}"]
            filled[key] = array.copy() if isinstance(value, np.ndarray) else array.item()
        else:
            filled[key] = value
    return filled
