"""The door task as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.door import task
from envs.door.simulator import DoorSimulator
from envs.door.starts import door_position

DOOR_POSITION_KEY = "door_position"


class DoorEnv(EnvBase):
    """N doors as one `EnvBase` of batch size [N], also for N = 1.

    Keys (float32 unless said): ``observation`` [N, 38], ``action`` [N, 28] in [-1, 1],
    ``reward`` [N, 1], ``done`` / ``terminated`` / ``truncated`` [N, 1] bool, and with every
    observation ``hinge_angle`` [N, 1] (rad) and ``success`` [N, 1] bool (hinge > 1.35 rad now).

    An episode is *truncated* by the environment itself after `horizon` steps, or once the door has
    been open for `open_steps`, and *terminated* only when the hand leaves the door
    (`envs.door.task.terminated`).

    A tensordict with ``door_position`` [N, 3] (m) given to `reset` places the doors for that reset;
    without it, and at automatic resets, positions are drawn per door from `envs.door.starts`.
    Doors that `_reset` or `_step` leave out stay as they are.

    `get_extra_state` / `set_extra_state` (so `state_dict` / `load_state_dict`) hold tensors only
    and continue a run bit for bit.

    Args:
        num_doors: N >= 1.
        horizon: Steps until truncation.
        open_steps: Truncates an episode after so many steps in a row with an open door (`success`):
            for training, which then spends its steps on opening doors. Default: never, as an
            episode is judged by all of its steps (paper, section IV-A).
        num_threads: Threads of the simulator. Default: one per core, at most N.
        seed: Seed of the door positions. Default: fresh entropy, not reproducible.
        device: Where the tensors live. The physics itself runs on the CPU.

    Raises:
        ValueError: If a count is below 1 or the seed is outside [0, 2**63).
    """

    def __init__(
        self,
        num_doors: int = 1,
        *,
        horizon: int = task.HORIZON,
        open_steps: int | None = None,
        num_threads: int | None = None,
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if horizon < 1:
            raise ValueError(f"horizon must be at least 1 step, got {horizon}")
        if open_steps is not None and open_steps < 1:
            raise ValueError(f"open_steps must be at least 1 step (or None), got {open_steps}")
        simulator = DoorSimulator(num_doors, num_threads)
        super().__init__(device=device, batch_size=[num_doors])
        self.horizon = horizon
        self.open_steps = open_steps
        self.simulator = simulator
        self._make_specs()
        self._set_seed(seed)

    @property
    def num_doors(self) -> int:
        """Number of doors N."""
        return self.simulator.num_doors

    @property
    def door_position(self) -> torch.Tensor:
        """Where the door frames stand now, shape [N, 3], float64, m."""
        return torch.as_tensor(self.simulator.door_position, device=self.device)

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """Steps since each door's last reset, shape [N], int64."""
        return torch.as_tensor(self._elapsed.copy(), device=self.device)

    def _make_specs(self) -> None:
        count, device = self.num_doors, self.device
        self.observation_spec = Composite(
            observation=Unbounded((count, task.OBSERVATION_SIZE), device=device),
            hinge_angle=Unbounded((count, 1), device=device),
            success=Binary(shape=(count, 1), dtype=torch.bool, device=device),
            shape=(count,),
            device=device,
        )
        self.action_spec = Bounded(-1.0, 1.0, (count, task.ACTION_SIZE), device=device)
        self.reward_spec = Unbounded((count, 1), device=device)
        flag = Binary(shape=(count, 1), dtype=torch.bool, device=device)
        self.done_spec = Composite(
            done=flag,
            terminated=flag.clone(),
            truncated=flag.clone(),
            shape=(count,),
            device=device,
        )

    def _set_seed(self, seed: int | None) -> None:
        """Start every door's stream of positions afresh; takes effect at each door's next reset."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> 1)
        # It is stored as an int64 tensor.
        if not 0 <= seed < 2**63:
            raise ValueError(f"seed must be in [0, 2**63), got {seed}")
        self._seed = seed
        self._episodes = np.zeros(self.num_doors, dtype=np.int64)
        self._elapsed = np.zeros(self.num_doors, dtype=np.int64)
        self._open = np.zeros(self.num_doors, dtype=np.int64)

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        given = None if tensordict is None else tensordict.get(DOOR_POSITION_KEY, None)
        if mask is None:
            doors = np.arange(self.num_doors)
        else:
            doors = np.flatnonzero(mask.reshape(-1).cpu().numpy())
        if given is None:
            positions = np.array(
                [door_position(self._seed, int(i), int(self._episodes[i])) for i in doors]
            ).reshape(-1, 3)
        else:
            positions = given.detach().cpu().double().numpy()[doors]
        self.simulator.reset(positions, doors)
        # A given position consumes its turn too: the k-th episode has one address, however begun.
        self._episodes[doors] += 1
        self._elapsed[doors] = 0
        self._open[doors] = 0
        observation = self.simulator.observation()
        return self._tensordict(self._observed(observation) | self._flags(observation, doors))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action").detach().cpu().numpy()
        mask = tensordict.get("_step", None)
        active = (
            np.ones(self.num_doors, dtype=bool)
            if mask is None
            else mask.reshape(-1).cpu().numpy().astype(bool)
        )
        observation = self.simulator.step(action, active)
        self._elapsed += active
        self._open = np.where(active, (self._open + 1) * task.success(observation), self._open)
        reward = np.where(active, task.reward(observation), np.float32(0))
        return self._tensordict(
            self._observed(observation) | self._flags(observation) | {"reward": reward}
        )

    def _observed(self, observation: NDArray[np.float32]) -> dict[str, NDArray[np.generic]]:
        return {
            "observation": observation,
            "hinge_angle": task.hinge_angle(observation),
            "success": task.success(observation),
        }

    def _flags(
        self, observation: NDArray[np.float32], fresh: NDArray[np.int64] | None = None
    ) -> dict[str, NDArray[np.generic]]:
        terminated = task.terminated(observation)
        if fresh is not None:
            # A door may be placed out of reach on request: its episode still has a first step.
            terminated[fresh] = False
        truncated = self._elapsed >= self.horizon
        if self.open_steps is not None:
            truncated |= self._open >= self.open_steps
        return {
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }

    def _tensordict(self, arrays: Mapping[str, NDArray[np.generic]]) -> TensorDict:
        tensors = {
            key: torch.from_numpy(np.ascontiguousarray(array.reshape(self.num_doors, -1)))
            for key, array in arrays.items()
        }
        return TensorDict(tensors, batch_size=self.batch_size, device=self.device)

    def get_extra_state(self) -> dict[str, torch.Tensor]:
        """All that a bit-exact continuation needs, as CPU tensors (`weights_only=True`-safe)."""
        arrays = self.simulator.get_state() | {
            "seed": np.asarray(self._seed, dtype=np.int64),
            "episodes": self._episodes.copy(),
            "elapsed": self._elapsed.copy(),
            "open": self._open.copy(),
        }
        return {key: torch.from_numpy(np.asarray(value)) for key, value in arrays.items()}

    def set_extra_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Continue from what `get_extra_state` returned.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If it was taken with another number of doors.
        """
        arrays = {key: value.cpu().numpy() for key, value in state.items()}
        if arrays["episodes"].shape != (self.num_doors,):
            raise ValueError(
                f"this state holds {len(arrays['episodes'])} doors, the environment has "
                f"{self.num_doors}: build it with num_doors={len(arrays['episodes'])}"
            )
        self.simulator.set_state(arrays)
        self._seed = int(arrays["seed"])
        self._episodes = arrays["episodes"].copy()
        self._elapsed = arrays["elapsed"].copy()
        # Not in states from before there was `open_steps`.
        self._open = arrays.get("open", np.zeros_like(self._elapsed)).copy()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the simulator's threads."""
        super().close(raise_if_closed=raise_if_closed)
        self.simulator.close()
