"""Somebody's environment, N copies of it, as one batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

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


class VectorEnv(EnvBase):
    """N copies of an environment as one `EnvBase` of batch size [N], also for N = 1.

    Keys (float32 unless said): ``observation`` [N, O], ``action`` [N, A] in [-1, 1], ``reward``
    [N, 1], ``done`` / ``terminated`` / ``truncated`` [N, 1] bool, and with every observation
    ``success`` [N, 1] bool and ``progress`` [N, 1] where the environment tells them.

    A tensordict with ``start_seed`` [N] given to `reset` seeds those episodes; without it, and at
    automatic resets, episode k of copy i has a seed made of the environment's seed, i and k. Copies
    that `_reset` or `_step` leave out stay as they are.

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
        count = len(copies.buffers.reward)
        super().__init__(device=device, batch_size=[count])
        self.copies = copies
        self.interface = interface
        self.success_steps = success_steps
        self.resumes_midway = interface.resumes_midway
        self._count = count
        self._last: dict[str, Array] = {}
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        count, device, interface = self._count, self.device, self.interface
        flag = Binary(shape=(count, 1), dtype=torch.bool, device=device)
        observed: dict[str, Any] = {
            "observation": Unbounded((count, interface.layout.flattener.size), device=device)
        }
        if interface.success is not None:
            observed[SUCCESS] = flag.clone()
        if interface.progress is not None:
            observed[PROGRESS] = Unbounded((count, 1), device=device)
        self.observation_spec = Composite(observed, shape=(count,), device=device)
        self.action_spec = Bounded(-1.0, 1.0, (count, interface.actions.size), device=device)
        self.reward_spec = Unbounded((count, 1), device=device)
        self.done_spec = Composite(
            done=flag.clone(),
            terminated=flag.clone(),
            truncated=flag.clone(),
            shape=(count,),
            device=device,
        )

    def _set_seed(self, seed: int | None) -> None:
        """Number the episodes afresh; takes effect at each copy's next reset."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0]) >> 1
        # It is stored as an int64 tensor.
        if not 0 <= seed < 2**63:
            raise ValueError(f"seed must be in [0, 2**63), got {seed}")
        self._seed = seed
        self._episodes = np.zeros(self._count, dtype=np.int64)
        self._returns = np.zeros(self._count)
        self._succeeded = np.zeros(self._count, dtype=np.int64)

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        given = None if tensordict is None else tensordict.get(START_SEED, None)
        chosen = _chosen(mask, self._count)
        if given is None:
            seeds = [episode_seed(self._seed, int(i), int(self._episodes[i])) for i in chosen]
        else:
            seeds = given.reshape(-1).cpu().numpy()[chosen].tolist()
        self.copies.reset(chosen.tolist(), seeds)
        # A given seed consumes its turn too: the k-th episode has one address, however begun.
        self._episodes[chosen] += 1
        self._returns[chosen] = 0.0
        self._succeeded[chosen] = 0
        self._measure(chosen, begun=True)
        return self._tensordict(self._observed() | self._flags())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        chosen = _chosen(tensordict.get("_step", None), self._count)
        unit = tensordict.get("action").detach().cpu().numpy()
        buffers = self.copies.buffers
        buffers.action[...] = self.interface.actions.to_environment(unit)
        before = buffers.observation.copy() if self.interface.reward is not None else None
        self.copies.step(chosen.tolist())
        reward = np.zeros(self._count)
        if before is None or self.interface.reward is None:
            reward[chosen] = buffers.reward[chosen]
        else:
            after = buffers.observation[chosen]
            reward[chosen] = self.interface.reward(before[chosen], unit[chosen], after)
        buffers.reward[...] = reward
        self._returns += reward
        self._measure(chosen)
        if SUCCESS in self._last:
            counted = (self._succeeded + 1) * self._last[SUCCESS]
            self._succeeded[chosen] = counted[chosen]
        return self._tensordict(
            self._observed() | self._flags() | {"reward": reward.astype(np.float32)}
        )

    def _measure(self, chosen: Array, *, begun: bool = False) -> None:
        """Success and progress of the copies that were stepped or reset; the others keep theirs."""
        signals = {SUCCESS: self.interface.success, PROGRESS: self.interface.progress}
        buffers = self.copies.buffers
        # Before its first step an episode has earned nothing that a bound could be passed with.
        nothing = np.full(self._count, np.nan)
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
        self._measure(np.arange(self._count))
        return self._tensordict(self._observed() | self._flags())

    def _observed(self) -> dict[str, Array]:
        return {"observation": self.copies.buffers.observation} | self._last

    def _flags(self) -> dict[str, Array]:
        terminated = self.copies.buffers.terminated
        truncated = self.copies.buffers.truncated.copy()
        if self.success_steps is not None:
            truncated |= self._succeeded >= self.success_steps
        return {
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }

    def _tensordict(self, arrays: Mapping[str, Array]) -> TensorDict:
        # Copied: the arrays are written again at the next step. (`torch.tensor` takes ten times as
        # long as numpy's copy.)
        columns = {
            key: torch.from_numpy(array.reshape(self._count, -1).copy())
            for key, array in arrays.items()
        }
        if PROGRESS in columns:
            columns[PROGRESS] = columns[PROGRESS].float()
        return TensorDict(columns, batch_size=self.batch_size, device=self.device)

    def get_extra_state(self) -> dict[str, torch.Tensor]:
        """Numbers of the episodes, and the whole state where it can be saved, as CPU tensors."""
        arrays: dict[str, Any] = {"seed": self._seed, "episodes": self._episodes.copy()}
        if self.resumes_midway:
            arrays |= {"returns": self._returns.copy(), "succeeded": self._succeeded.copy()}
            arrays |= {f"last/{key}": array.copy() for key, array in self._last.items()}
            arrays |= {f"copies/{key}": value for key, value in self.copies.get_state().items()}
        return {key: torch.tensor(value) for key, value in arrays.items()}

    def set_extra_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Continue from what `get_extra_state` returned.

        Raises:
            ValueError: it was taken with another number of copies.
        """
        arrays = {key: value.cpu().numpy() for key, value in state.items()}
        if arrays["episodes"].shape != (self._count,):
            raise ValueError(
                f"this state holds {len(arrays['episodes'])} copies of "
                f"{self.interface.layout.name}, and there are {self._count}: "
                f"set env.num_envs={len(arrays['episodes'])}"
            )
        self._seed = int(arrays["seed"])
        self._episodes = arrays["episodes"].copy()
        # A run may have begun before its environment could be saved: its episodes begin anew.
        if not self.resumes_midway or "returns" not in arrays:
            return
        self._returns = arrays["returns"].copy()
        self._succeeded = arrays["succeeded"].copy()
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


def _chosen(mask: torch.Tensor | None, count: int) -> Array:
    if mask is None:
        return np.arange(count)
    return np.flatnonzero(mask.reshape(-1).cpu().numpy())


def _under(prefix: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {k.removeprefix(prefix): v.copy() for k, v in arrays.items() if k.startswith(prefix)}
