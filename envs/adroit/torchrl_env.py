"""A hand task as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Unbounded

from envs.adroit.hand import Judged
from envs.adroit.resimulation import QPOS, QVEL
from envs.adroit.simulator import HandSimulator
from envs.adroit.starts import placement_of
from envs.adroit.touch import FORCES, OPPOSITION
from envs.batched import BatchedEnv, Now
from envs.task import PROGRESS, SUCCESS


class HandEnv(BatchedEnv):
    """N copies of a hand task.

    What it writes: see `BatchedEnv`; always ``success`` and ``progress``. An episode is *truncated*
    by the environment itself after `horizon` steps, or once it has been a success for
    `success_steps`, and *terminated* only where the task says so.

    A tensordict with names of the placement, [N, k] each, given to `reset` places these things for
    that reset; without it, and at automatic resets, they are drawn per copy from
    `envs.adroit.starts`; with ``qpos`` [N, nq] and ``qvel`` [N, nv], it begins in that state of the
    joints.

    `get_extra_state` / `set_extra_state` (so `state_dict` / `load_state_dict`) hold tensors only
    and continue a run bit for bit.

    Args:
        simulator: Of the copies, N >= 1.
        horizon: Steps until truncation. Default: the task's.
        success_steps: Truncates an episode after so many steps of success in a row. Default: never.
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
        task = simulator.task
        super().__init__(
            simulator.num_copies,
            horizon=task.horizon if horizon is None else horizon,
            success_steps=success_steps,
            called=task.copies,
            device=device,
        )
        self.sparse = sparse
        self.contacts = contacts
        self.simulator = simulator
        self._make_specs(task.observation_size, task.action_size, success=True, progress=True)
        if contacts:
            simulator.record_contacts()
            count, size = self.num_copies, simulator.forces[0].size
            self.observation_spec[FORCES] = Unbounded((count, size), device=self.device)
            self.observation_spec[OPPOSITION] = Unbounded((count, 1), device=self.device)
        self._set_seed(seed)

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """Steps since each copy's last reset, shape [N], int64."""
        return torch.as_tensor(self._elapsed.copy(), device=self.device)

    def _begin(self, copies: NDArray[np.int64], given: TensorDictBase | None) -> Now:
        self.simulator.start(
            self._placement(given, copies),
            copies,
            qpos=_given(given, QPOS, copies),
            qvel=_given(given, QVEL, copies),
        )
        observation = self.simulator.observation()
        judged = self.simulator.judged(observation)
        # A copy may be placed out of reach on request: its episode still has a first step.
        judged.terminated[copies] = False
        return self._now(observation, judged)

    def _advance(
        self, copies: NDArray[np.int64], action: NDArray[np.floating]
    ) -> tuple[Now, NDArray[np.float32]]:
        active = np.zeros(self.num_copies, dtype=bool)
        active[copies] = True
        observation = self.simulator.step(action, active)
        judged = self.simulator.judged(observation)
        paid = judged.success.astype(np.float32) - 1 if self.sparse else judged.reward
        return self._now(observation, judged), paid

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
        now = self._now(observation, self.simulator.judged(observation))
        return begun.update(self._columns(now.observed))

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

    def _now(self, observation: NDArray[np.float32], judged: Judged) -> Now:
        observed: dict[str, NDArray[Any]] = {
            "observation": observation,
            PROGRESS: judged.progress,
            SUCCESS: judged.success,
        }
        if self.contacts:
            observed |= {FORCES: self.simulator.forces, OPPOSITION: self.simulator.opposition}
        return Now(observed, judged.terminated, np.zeros_like(judged.terminated))

    def _saved(self) -> dict[str, NDArray[Any]]:
        """All that a bit-exact continuation needs."""
        return self.simulator.get_state() | {
            "elapsed": self._elapsed,
            "success_streak": self._succeeded,
        }

    def _restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self.simulator.set_state(arrays)
        self._elapsed = arrays["elapsed"]
        # States of before call it "open" or, of before there was `success_steps`, do not have it.
        found = arrays.get("success_streak", arrays.get("open"))
        self._succeeded = np.zeros_like(self._elapsed) if found is None else found

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
