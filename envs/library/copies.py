"""Copies of one environment, stepped one after the other into arrays that all of them share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.flatten import Flattener
from envs.library import calls
from envs.library.memory import require_memory
from envs.library.own_state import OwnStateError
from envs.library.state import require_same, restore_state, save_state
from envs.one_line import kind_and_text
from envs.task import TaskFailedError

Array = NDArray[Any]
Allocate = Callable[[tuple[int, ...], Any], Array]


@dataclass(frozen=True, eq=False)
class Buffers:
    """What N copies wrote last; copies that were left out keep their rows.

    Attributes:
        observation: float32 [N, O].
        reward: float64 [N].
        terminated: bool [N].
        truncated: bool [N].
        info: float64 [N, K], NaN where a copy did not tell.
        action: what to do, in the environment's units, [N, *shape].
    """

    observation: Array
    reward: Array
    terminated: Array
    truncated: Array
    info: Array
    action: Array

    @classmethod
    def make(cls, count: int, layout: Layout, allocate: Allocate = np.zeros) -> Self:
        """Buffers of zeros for ``count`` copies."""
        return cls(
            observation=allocate((count, layout.flattener.size), np.float32),
            reward=allocate((count,), np.float64),
            terminated=allocate((count,), np.bool_),
            truncated=allocate((count,), np.bool_),
            info=allocate((count, len(layout.info)), np.float64),
            action=allocate((count, *layout.action_shape), layout.action_dtype),
        )

    def part(self, chosen: slice) -> Buffers:
        """Views of some copies' rows."""
        return Buffers(**{name: array[chosen] for name, array in vars(self).items()})


@dataclass(frozen=True)
class Layout:
    """What copies write.

    Attributes:
        name: of the task, for messages.
        flattener: of observations.
        info: keys of ``info`` to keep, [K].
        action_shape: of one action.
        action_dtype: of it.
    """

    name: str
    flattener: Flattener
    info: tuple[str, ...]
    action_shape: tuple[int, ...]
    action_dtype: Any


class Copies:
    """N copies in this process.

    Args:
        make: makes one.
        buffers: to write into.
        layout: what to write.
        first: number of the first copy, for messages.
        sharers: processes that make as many copies at the same time, and share the free memory.

    Raises:
        ValueError: they do not fit into the free memory.
    """

    def __init__(
        self,
        make: Callable[[], gymnasium.Env[Any, Any]],
        buffers: Buffers,
        layout: Layout,
        *,
        first: int = 0,
        sharers: int = 1,
    ) -> None:
        self.buffers = buffers
        self.layout = layout
        self.first = first
        self.envs = require_memory(layout.name, make, len(buffers.reward), sharers=sharers)
        self.elapsed = np.zeros(len(self.envs), dtype=np.int64)

    def reset(self, copies: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin new episodes in some copies.

        Raises:
            TaskFailedError: an environment raised.
        """
        for i, seed in zip(copies, seeds, strict=True):
            try:
                observation, info = calls.reset(self.envs[i], seed=int(seed))
                self._write(i, observation, info)
            # Whatever somebody's environment raises is told in one line.
            except Exception as error:
                raise self._failed(i, f"in reset(seed={seed})", error) from error
            self.elapsed[i] = 0
            self.buffers.reward[i] = 0.0
            self.buffers.terminated[i] = self.buffers.truncated[i] = False

    def step(self, copies: Sequence[int]) -> None:
        """One step of some copies, with the actions in the buffers.

        Raises:
            TaskFailedError: an environment raised.
        """
        buffers = self.buffers
        for i in copies:
            try:
                # Some keep the action they were given, and the buffer is written again.
                result = calls.step(self.envs[i], buffers.action[i].copy())
                observation, reward, terminated, truncated, info = result
                self._write(i, observation, info)
                buffers.reward[i] = reward
            except Exception as error:
                raise self._failed(i, f"in step {self.elapsed[i] + 1}", error) from error
            buffers.terminated[i], buffers.truncated[i] = terminated, truncated
            self.elapsed[i] += 1

    def place(self, copy: int, put: Callable[[gymnasium.Env[Any, Any]], Any]) -> None:
        """Have ``put`` change a copy's state; what it returns is the observation then."""
        self.layout.flattener.write(put(self.envs[copy]), self.buffers.observation[copy])

    def get_state(self) -> dict[str, Array]:
        """The whole state of all copies, stacked; for environments that can be saved.

        Raises:
            TaskFailedError: an environment's own ``get_state`` failed, or gave a copy a state of
                other names or shapes than the others.
        """
        states = []
        for i, env in enumerate(self.envs):
            try:
                states.append(save_state(env))
                require_same(states[0], states[-1])
            except OwnStateError as error:
                raise TaskFailedError(f"{self._named(i)}: {error}") from error
        stacked = {key: np.stack([state[key] for state in states]) for key in states[0]}
        shared = {name: array.copy() for name, array in vars(self.buffers).items()}
        return (
            stacked
            | {f"buffer/{k}": v for k, v in shared.items()}
            | {"elapsed": self.elapsed.copy()}
        )

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Continue from what :meth:`get_state` gave.

        Raises:
            TaskFailedError: an environment's own ``set_state`` failed.
        """
        for name, array in vars(self.buffers).items():
            array[...] = state[f"buffer/{name}"]
        self.elapsed[...] = state["elapsed"]
        for i, env in enumerate(self.envs):
            try:
                restore_state(env, {key: values[i] for key, values in state.items()})
            except OwnStateError as error:
                raise TaskFailedError(f"{self._named(i)}: {error}") from error

    def close(self) -> None:
        """Close all copies.

        Raises:
            TaskFailedError: an environment raised; the others are closed all the same.
        """
        failed = None
        for i, env in enumerate(self.envs):
            try:
                env.close()
            except Exception as error:
                failed = failed or self._failed(i, "in close()", error)
        if failed is not None:
            raise failed

    def _write(self, i: int, observation: Any, info: Mapping[str, Any]) -> None:
        self.layout.flattener.write(observation, self.buffers.observation[i])
        for k, key in enumerate(self.layout.info):
            self.buffers.info[i, k] = info.get(key, np.nan)

    def _failed(self, i: int, when: str, error: Exception) -> TaskFailedError:
        copy = self._named(i)
        if isinstance(error, calls.OtherApiError):
            return TaskFailedError(f"{copy} {when}: {error}")
        return TaskFailedError(f"{copy} raised {when}: {kind_and_text(error)}")

    def _named(self, i: int) -> str:
        return f"task {self.layout.name}: copy {self.first + i}"
