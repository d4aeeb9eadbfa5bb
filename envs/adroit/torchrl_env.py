"""A hand task as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.adroit.hand import Judged
from envs.adroit.resimulation import QPOS, QVEL
from envs.adroit.simulator import HandSimulator
from envs.adroit.starts import placement_of
from envs.adroit.touch import FORCES, OPPOSITION


class HandEnv(EnvBase):
    """N copies of a hand task as one `EnvBase` of batch size [N], also for N = 1.

    Keys (float32 unless said): ``observation`` [N, O], ``action`` [N, A] in [-1, 1],
    ``reward`` [N, 1], ``done`` / ``terminated`` / ``truncated`` [N, 1] bool, and with every
    observation ``progress`` [N, 1] (in the task's unit) and ``success`` [N, 1] bool (now).

    An episode is *truncated* by the environment itself after `horizon` steps, or once it has been a
    success for `success_steps`, and *terminated* only where the task says so.

    A tensordict with names of the placement, [N, k] each, given to `reset` places these things for
    that reset; without it, and at automatic resets, they are drawn per copy from
    `envs.adroit.starts`; with ``qpos`` [N, nq] and ``qvel`` [N, nv], it begins in that state of the
    joints. Copies that `_reset` or `_step` leave out stay as they are.

    `get_extra_state` / `set_extra_state` (so `state_dict` / `load_state_dict`) hold tensors only
    and continue a run bit for bit.

    Args:
        simulator: Of the copies, N >= 1.
        horizon: Steps until truncation. Default: the task's.
        success_steps: Truncates an episode after so many steps of success in a row: for training,
            which then spends its steps on getting there. Default: never.
        contacts: Writes ``contact_forces`` and ``opposition`` besides (`envs.adroit.touch`).
        sparse: Pays success - 1 at every step (RLPD's binary tasks) in place of the task's reward.
        seed: Seed of the starts. Default: fresh entropy, not reproducible.
        device: Where the tensors live. The physics itself runs on the CPU.

    Raises:
        ValueError: If a count is below 1 or the seed is outside [0, 2**63).
    """

    def __init__(
        self,
        simulator: HandSimulator,
        *,
        horizon: int | None = None,
        success_steps: int | None = None,
        sparse: bool = False,
        contacts: bool = False,
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if horizon is not None and horizon < 1:
            raise ValueError(f"horizon must be at least 1 step, got {horizon}")
        if success_steps is not None and success_steps < 1:
            raise ValueError(
                f"success_steps must be at least 1 step (or None), got {success_steps}"
            )
        super().__init__(device=device, batch_size=[simulator.num_copies])
        self.horizon = horizon or simulator.task.horizon
        self.success_steps = success_steps
        self.sparse = sparse
        self.contacts = contacts
        self.simulator = simulator
        if contacts:
            simulator.record_contacts()
        self._make_specs()
        self._set_seed(seed)

    @property
    def num_copies(self) -> int:
        """Number of copies N."""
        return self.simulator.num_copies

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """Steps since each copy's last reset, shape [N], int64."""
        return torch.as_tensor(self._elapsed.copy(), device=self.device)

    def _make_specs(self) -> None:
        count, device, task = self.num_copies, self.device, self.simulator.task
        self.observation_spec = Composite(
            observation=Unbounded((count, task.observation_size), device=device),
            progress=Unbounded((count, 1), device=device),
            success=Binary(shape=(count, 1), dtype=torch.bool, device=device),
            shape=(count,),
            device=device,
        )
        if self.contacts:
            size = self.simulator.forces[0].size
            self.observation_spec[FORCES] = Unbounded((count, size), device=device)
            self.observation_spec[OPPOSITION] = Unbounded((count, 1), device=device)
        self.action_spec = Bounded(-1.0, 1.0, (count, task.action_size), device=device)
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
        """Start every copy's stream of starts afresh; takes effect at each copy's next reset."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0]) >> 1
        # It is stored as an int64 tensor.
        if not 0 <= seed < 2**63:
            raise ValueError(f"seed must be in [0, 2**63), got {seed}")
        self._seed = seed
        self._episodes = np.zeros(self.num_copies, dtype=np.int64)
        self._elapsed = np.zeros(self.num_copies, dtype=np.int64)
        self._success_streak = np.zeros(self.num_copies, dtype=np.int64)

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            copies = np.arange(self.num_copies)
        else:
            copies = np.flatnonzero(mask.reshape(-1).cpu().numpy())
        self.simulator.start(
            self._placement(tensordict, copies),
            copies,
            qpos=_given(tensordict, QPOS, copies),
            qvel=_given(tensordict, QVEL, copies),
        )
        # A given placement consumes its turn too: the k-th episode has one address, however begun.
        self._episodes[copies] += 1
        self._elapsed[copies] = 0
        self._success_streak[copies] = 0
        observation = self.simulator.observation()
        judged = self.simulator.judged(observation)
        # A copy may be placed out of reach on request: its episode still has a first step.
        judged.terminated[copies] = False
        return self._tensordict(self._observed(observation, judged) | self._flags(judged))

    def place(
        self,
        placement: Mapping[str, NDArray[np.float64]],
        qpos: NDArray[np.float64] | None = None,
        qvel: NDArray[np.float64] | None = None,
    ) -> TensorDictBase:
        """Begin new episodes in a state of one's own, which need not be the tasks' reset pose.

        Args:
            placement: Where things stand, by name, [N, k] each.
            qpos: Joint positions [N, nq]; None is the reset pose.
            qvel: Joint velocities [N, nv]; None is rest.

        Returns:
            As `reset` does.
        """
        where = {name: torch.as_tensor(values) for name, values in placement.items()}
        begun = self.reset(TensorDict(where, self.batch_size))
        self.simulator.start(placement, qpos=qpos, qvel=qvel)
        observation = self.simulator.observation()
        now = self._tensordict(self._observed(observation, self.simulator.judged(observation)))
        return begun.update(now)

    def _placement(
        self, tensordict: TensorDictBase | None, copies: NDArray[np.int64]
    ) -> dict[str, NDArray[np.float64]]:
        sizes = {name: values.shape[1] for name, values in self.simulator.placement.items()}
        asked = {name: _given(tensordict, name, copies) for name in sizes}
        found = {name: value for name, value in asked.items() if value is not None}
        missing = sizes.keys() - found.keys()
        if missing:
            task, seed = self.simulator.task, self._seed
            drawn = [placement_of(task, seed, int(i), int(self._episodes[i])) for i in copies]
            for name in missing:
                found[name] = np.array([one[name] for one in drawn]).reshape(-1, sizes[name])
        return found

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action").detach().cpu().numpy()
        mask = tensordict.get("_step", None)
        active = (
            np.ones(self.num_copies, dtype=bool)
            if mask is None
            else mask.reshape(-1).cpu().numpy().astype(bool)
        )
        observation = self.simulator.step(action, active)
        judged = self.simulator.judged(observation)
        self._elapsed += active
        self._success_streak = np.where(
            active, (self._success_streak + 1) * judged.success, self._success_streak
        )
        paid = judged.success.astype(np.float32) - 1 if self.sparse else judged.reward
        reward = np.where(active, paid, np.float32(0))
        return self._tensordict(
            self._observed(observation, judged) | self._flags(judged) | {"reward": reward}
        )

    def _observed(
        self, observation: NDArray[np.float32], judged: Judged
    ) -> dict[str, NDArray[np.generic]]:
        observed: dict[str, NDArray[np.generic]] = {
            "observation": observation,
            "progress": judged.progress.astype(np.float32, copy=False),
            "success": judged.success,
        }
        if self.contacts:
            observed |= {FORCES: self.simulator.forces, OPPOSITION: self.simulator.opposition}
        return observed

    def _flags(self, judged: Judged) -> dict[str, NDArray[np.generic]]:
        truncated = self._elapsed >= self.horizon
        if self.success_steps is not None:
            truncated |= self._success_streak >= self.success_steps
        return {
            "terminated": judged.terminated,
            "truncated": truncated,
            "done": judged.terminated | truncated,
        }

    def _tensordict(self, arrays: Mapping[str, NDArray[np.generic]]) -> TensorDict:
        tensors = {
            key: torch.from_numpy(np.ascontiguousarray(array.reshape(self.num_copies, -1)))
            for key, array in arrays.items()
        }
        return TensorDict(tensors, batch_size=self.batch_size, device=self.device)

    def get_extra_state(self) -> dict[str, torch.Tensor]:
        """All that a bit-exact continuation needs, as CPU tensors (`weights_only=True`-safe)."""
        arrays = self.simulator.get_state() | {
            "seed": np.asarray(self._seed, dtype=np.int64),
            "episodes": self._episodes.copy(),
            "elapsed": self._elapsed.copy(),
            "success_streak": self._success_streak.copy(),
        }
        return {key: torch.from_numpy(np.asarray(value)) for key, value in arrays.items()}

    def set_extra_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Continue from what `get_extra_state` returned.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If it was taken with another number of copies.
        """
        arrays = {key: value.cpu().numpy() for key, value in state.items()}
        called = self.simulator.task.copies
        if arrays["episodes"].shape != (self.num_copies,):
            raise ValueError(
                f"this state holds {len(arrays['episodes'])} {called}, the environment has "
                f"{self.num_copies}: build it with num_envs={len(arrays['episodes'])}"
            )
        self.simulator.set_state(arrays)
        self._seed = int(arrays["seed"])
        self._episodes = arrays["episodes"].copy()
        self._elapsed = arrays["elapsed"].copy()
        # States of before call it "open" or, of before there was `success_steps`, do not have it.
        found = arrays.get("success_streak", arrays.get("open"))
        self._success_streak = np.zeros_like(self._elapsed) if found is None else found.copy()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the simulator's threads."""
        super().close(raise_if_closed=raise_if_closed)
        self.simulator.close()


def _given(
    tensordict: TensorDictBase | None, name: str, copies: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    """What a reset says of these copies, [n, k]; None if nothing."""
    value = None if tensordict is None else tensordict.get(name, None)
    return None if value is None else value.detach().cpu().double().numpy()[copies]
