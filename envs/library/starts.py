"""Where an episode of a library's environment begins, and putting it where another one began."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from envs.demonstrations.schema import StartKey
from envs.library.vector_env import START_SEED, episode_seed

Env = gymnasium.Env[Any, Any]
SEED: Final = StartKey(START_SEED, 1, ("seed",))


def seeds(seed: int, first: int, count: int) -> TensorDict:
    """Start seeds [count] of the episodes ``first``, ... of the list with this seed."""
    numbers = [episode_seed(seed, first + i) for i in range(count)]
    return TensorDict({START_SEED: torch.tensor(numbers)}, [count])


@dataclass(frozen=True)
class StartState:
    """How a state is put into an environment.

    Attributes:
        keys: vectors that make it up.
        by_name: whether ``set_env_state`` takes them by name (Adroit); else ``set_state`` takes
            joint positions and velocities (gymnasium's ``MujocoEnv``).
        shapes: of the environment's own arrays, by key.
    """

    keys: tuple[StartKey, ...]
    by_name: bool
    shapes: Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class Place:
    """Puts a recorded start into a copy; travels to worker processes."""

    start: StartState
    values: Mapping[str, NDArray[np.float64]]

    def __call__(self, env: Env) -> Any:
        """Change the state; returns the observation there."""
        inner: Any = env.unwrapped
        shaped = {key: self.values[key].reshape(shape) for key, shape in self.start.shapes.items()}
        if self.start.by_name:
            inner.set_env_state(shaped)
        else:
            inner.set_state(shaped["qpos"], shaped["qvel"])
        return inner._get_obs()


def start_state(env: Env) -> StartState | None:
    """How recorded states are put into ``env``, by trying with its own; None if they cannot be.

    Wrappers that change observations would not see such a state: then it cannot be.
    """
    inner: Any = env.unwrapped
    if not callable(getattr(inner, "_get_obs", None)):
        return None
    if env.observation_space != inner.observation_space:
        return None
    by_name = callable(getattr(inner, "set_env_state", None))
    try:
        env.reset(seed=0)
        state = _state_of(inner, by_name)
        place = Place(_described(state, by_name), {k: v.ravel() for k, v in state.items()})
        same = np.array_equal(inner._get_obs(), place(env))
    # Whatever these methods of somebody's environment raise, they do not do what is needed.
    except Exception:
        return None
    return place.start if same else None


def _state_of(inner: Any, by_name: bool) -> dict[str, NDArray[np.float64]]:
    if by_name:
        taken = inner.get_env_state()
        return {key: np.array(value, np.float64) for key, value in taken.items()}
    return {key: np.array(getattr(inner.data, key), np.float64) for key in ("qpos", "qvel")}


def _described(state: Mapping[str, NDArray[np.float64]], by_name: bool) -> StartState:
    keys = tuple(StartKey(key, value.size) for key, value in state.items())
    return StartState(keys, by_name, {key: value.shape for key, value in state.items()})
