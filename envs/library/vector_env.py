"""Somebody's environment, N copies of it, as one batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from envs.batched import BatchedEnv, Now
from envs.library.actions import ActionScale
from envs.library.copies import Buffers, Layout
from envs.library.signals import Signal, Steps
from envs.task import PROGRESS, SUCCESS

Array = NDArray[Any]
START_SEED: Final = "start_seed"
"""What an episode is reset with, int64 [N]."""


class Stepped(Protocol):
    """N copies, in this process or in others."""

    buffers: Buffers

    def reset(self, copies: Any, seeds: Any) -> None:
        """Begin new episodes in some copies."""
        ...

    def step(self, copies: Any) -> None:
        """One step of some copies, with the actions in the buffers."""
        ...

    def place(self, copy: int, put: Callable[[gymnasium.Env[Any, Any]], Any]) -> None:
        """Have ``put`` change a copy's state; it returns the observation then."""
        ...

    def get_state(self) -> dict[str, Array]:
        """The whole state of all copies."""
        ...

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Continue from it."""
        ...

    def close(self) -> None:
        """Close all copies."""
        ...


@dataclass(frozen=True)
class Interface:
    """How an environment is read and driven.

    Attributes:
        layout: what its copies write.
        actions: their units.
        success: tells success, if anything does.
        progress: likewise.
        reward: replaces the environment's own.
        resumes_midway: whether its state can be saved.
    """

    layout: Layout
    actions: ActionScale
    success: Signal | None
    progress: Signal | None
    reward: Callable[[Array, Array, Array], Array] | None
    resumes_midway: bool


class VectorEnv(BatchedEnv):
    """N copies of an environment; what it writes: see `BatchedEnv`.

    A tensordict with ``start_seed`` [N] given to `reset` seeds those episodes; without it, and at
    automatic resets, episode k of copy i has a seed made of the environment's seed, i and k.

    Args:
        copies: what is stepped.
        interface: how.
        seed: of the episodes; None is fresh entropy, not reproducible.
        success_steps: truncates an episode after so many steps of success in a row.
        device: where the tensors live.
    """

    def __init__(
        self,
        copies: Stepped,
        interface: Interface,
        *,
        seed: int | None = None,
        success_steps: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(
            len(copies.buffers.reward),
            horizon=None,
            success_steps=success_steps,
            called=f"copies of {interface.layout.name}",
            device=device,
        )
        self.copies = copies
        self.interface = interface
        self.resumes_midway = interface.resumes_midway
        self._last: dict[str, Array] = {}
        self._make_specs(
            interface.layout.flattener.size,
            interface.actions.size,
            success=interface.success is not None,
            progress=interface.progress is not None,
        )
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        super()._set_seed(seed)
        self._returns = np.zeros(self.num_copies)

    def _begin(self, copies: Array, given: TensorDictBase | None) -> Now:
        seeds = None if given is None else given.get(START_SEED, None)
        if seeds is None:
            chosen = [episode_seed(self._seed, int(i), int(self._episodes[i])) for i in copies]
        else:
            chosen = seeds.reshape(-1).cpu().numpy()[copies].tolist()
        self.copies.reset(copies.tolist(), chosen)
        self._returns[copies] = 0.0
        self._measure(copies, begun=True)
        return self._now()

    def _advance(self, copies: Array, action: Array) -> tuple[Now, Array]:
        buffers = self.copies.buffers
        buffers.action[...] = self.interface.actions.to_environment(action)
        before = buffers.observation.copy() if self.interface.reward is not None else None
        self.copies.step(copies.tolist())
        reward = np.zeros(self.num_copies)
        if before is None or self.interface.reward is None:
            reward[copies] = buffers.reward[copies]
        else:
            after = buffers.observation[copies]
            reward[copies] = self.interface.reward(before[copies], action[copies], after)
        buffers.reward[...] = reward
        self._returns += reward
        self._measure(copies)
        return self._now(), reward

    def _measure(self, chosen: Array, *, begun: bool = False) -> None:
        """Success and progress of the copies that were stepped or reset; the others keep theirs."""
        signals = {SUCCESS: self.interface.success, PROGRESS: self.interface.progress}
        buffers = self.copies.buffers
        # Before its first step an episode has earned nothing that a bound could be passed with.
        nothing = np.full(self.num_copies, np.nan)
        steps = Steps(
            observation=buffers.observation,
            reward=nothing if begun else buffers.reward,
            returns=nothing if begun else self._returns,
            terminated=buffers.terminated,
            info={key: buffers.info[:, k] for k, key in enumerate(self.interface.layout.info)},
        )
        for column, signal in signals.items():
            if signal is None:
                continue
            told = signal.measure(steps)
            kept = self._last.setdefault(column, told.copy())
            kept[chosen] = told[chosen]

    def place(self, start: Callable[[gymnasium.Env[Any, Any]], Any]) -> TensorDictBase:
        """Have ``start`` put copy 0 into another state, and observe it.

        Args:
            start: changes the state and returns the observation there.
        """
        self.copies.place(0, start)
        self._measure(np.arange(self.num_copies))
        return self._told(self._now())

    def _now(self) -> Now:
        buffers = self.copies.buffers
        observed = {"observation": buffers.observation} | self._last
        return Now(observed, buffers.terminated, buffers.truncated)

    def _saved(self) -> dict[str, Array]:
        """The whole state, where it can be saved."""
        if not self.resumes_midway:
            return {}
        arrays: dict[str, Array] = {"returns": self._returns, "succeeded": self._succeeded}
        arrays |= {f"last/{key}": array for key, array in self._last.items()}
        return arrays | {f"copies/{key}": value for key, value in self.copies.get_state().items()}

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        # A run may have begun before its environment could be saved: its episodes begin anew.
        if not self.resumes_midway or "returns" not in arrays:
            return
        self._returns = arrays["returns"]
        self._succeeded = arrays["succeeded"]
        self._last = _under("last/", arrays)
        self.copies.set_state(_under("copies/", arrays))

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the copies."""
        super().close(raise_if_closed=raise_if_closed)
        self.copies.close()


def episode_seed(seed: int, *address: int) -> int:
    """The seed of one episode, below 2**31: some environments take no larger one.

    Addressed by number instead of being drawn: what a copy sees depends neither on how many there
    are nor on when the others are reset.
    """
    return int(np.random.SeedSequence(seed, spawn_key=address).generate_state(1)[0]) >> 1


def _under(prefix: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
