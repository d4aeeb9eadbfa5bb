"""N copies of a task as one batched TorchRL environment: the bookkeeping that all of them share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.task import PROGRESS, SUCCESS

Array = NDArray[Any]


@dataclass(frozen=True)
class Now:
    """What N copies show; all arrays have the first dimension [N].

    Attributes:
        observed: what is written with every observation, by key.
        terminated: bool [N].
        truncated: bool [N], by the copies themselves.
    """

    observed: Mapping[str, Array]
    terminated: Array
    truncated: Array


class BatchedEnv(EnvBase):
    """N copies as one `EnvBase` of batch size [N], also for N = 1.

    Keys (float32 unless said): ``observation`` [N, O], ``action`` [N, A] in [-1, 1], ``reward``
    [N, 1], ``done`` / ``terminated`` / ``truncated`` [N, 1] bool, and with every observation
    ``success`` [N, 1] bool (now) and ``progress`` [N, 1] (in the task's unit) where it has them.

    Episode k of copy i is addressed by the seed, i and k: what a copy sees depends neither on how
    many there are nor on when the others are reset. Copies that ``_reset`` or ``_step`` leave out
    stay as they are. A subclass says how copies begin, step and look, and calls `_make_specs` and
    `_set_seed` at the end of its constructor.

    Args:
        count: of copies, N.
        horizon: steps until truncation; None: copies truncate themselves.
        success_steps: truncates an episode after so many steps of success in a row: for training,
            which then spends its steps on getting there. None never does.
        called: what the copies are called in messages: ``doors``.
        device: where the tensors live.

    Raises:
        ValueError: a count is below 1.
    """

    def __init__(
        self,
        count: int,
        *,
        horizon: int | None,
        success_steps: int | None,
        called: str,
        device: torch.device | str,
    ) -> None:
        for name, steps in (("horizon", horizon), ("success_steps", success_steps)):
            if steps is not None and steps < 1:
                raise ValueError(f"{name} must be at least 1 step (or None), got {steps}")
        super().__init__(device=device, batch_size=[count])
        self.num_copies = count
        self.horizon = horizon
        self.success_steps = success_steps
        self._called = called

    # ------------------------------------------------------------------ what a subclass says

    @abstractmethod
    def _begin(self, copies: NDArray[np.int64], given: TensorDictBase | None) -> Now:
        """Begin episodes number ``_episodes`` of some copies.

        Args:
            copies: Their numbers.
            given: What the reset was called with.
        """

    @abstractmethod
    def _advance(self, copies: NDArray[np.int64], action: Array) -> tuple[Now, Array]:
        """One step of some copies.

        Args:
            copies: Their numbers.
            action: Of all copies, [N, A].

        Returns:
            What all copies show then, and their rewards [N]; those of others count nothing.
        """

    # ------------------------------------------------------------------ what it has from here

    def _make_specs(
        self, observation_size: int, action_size: int, *, success: bool, progress: bool
    ) -> None:
        count, device = self.num_copies, self.device
        flag = Binary(shape=(count, 1), dtype=torch.bool, device=device)
        number = Unbounded((count, 1), device=device)
        observed: dict[str, Any] = {
            "observation": Unbounded((count, observation_size), device=device)
        }
        observed |= {PROGRESS: number.clone()} if progress else {}
        observed |= {SUCCESS: flag.clone()} if success else {}
        self.observation_spec = Composite(observed, shape=(count,), device=device)
        self.action_spec = Bounded(-1.0, 1.0, (count, action_size), device=device)
        self.reward_spec = number
        self.done_spec = Composite(
            done=flag.clone(),
            terminated=flag.clone(),
            truncated=flag.clone(),
            shape=(count,),
            device=device,
        )

    def _set_seed(self, seed: int | None) -> None:
        """Number the episodes afresh; takes effect at each copy's next reset.

        Raises:
            ValueError: The seed is outside [0, 2**63).
        """
        self._seed = fresh_seed() if seed is None else seed
        # It is stored as an int64 tensor.
        if not 0 <= self._seed < 2**63:
            raise ValueError(f"seed must be in [0, 2**63), got {seed}")
        self._episodes = np.zeros(self.num_copies, dtype=np.int64)
        self._elapsed = np.zeros(self.num_copies, dtype=np.int64)
        self._succeeded = np.zeros(self.num_copies, dtype=np.int64)

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        copies = chosen_copies(tensordict, "_reset", self.num_copies)
        now = self._begin(copies, tensordict)
        # A given start consumes its turn too: the k-th episode has one address, however begun.
        self._episodes[copies] += 1
        self._elapsed[copies] = 0
        self._succeeded[copies] = 0
        return self._told(now)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        copies = chosen_copies(tensordict, "_step", self.num_copies)
        now, reward = self._advance(copies, tensordict.get("action").detach().cpu().numpy())
        self._elapsed[copies] += 1
        if SUCCESS in now.observed:
            counted = (self._succeeded + 1) * now.observed[SUCCESS]
            self._succeeded[copies] = counted[copies]
        paid = np.zeros(self.num_copies, dtype=np.float32)
        paid[copies] = reward[copies]
        return self._told(now).set("reward", self._columns({"reward": paid})["reward"])

    def _told(self, now: Now) -> TensorDict:
        truncated = now.truncated
        if self.horizon is not None:
            truncated = truncated | (self._elapsed >= self.horizon)
        if self.success_steps is not None:
            truncated = truncated | (self._succeeded >= self.success_steps)
        flags = {
            "terminated": now.terminated,
            "truncated": truncated,
            "done": now.terminated | truncated,
        }
        return self._columns({**now.observed, **flags})

    def _columns(self, arrays: Mapping[str, Array]) -> TensorDict:
        # Copied: the arrays may be written again at the next step. (`torch.tensor` takes ten times
        # as long as numpy's copy.)
        columns = {
            key: torch.from_numpy(array.reshape(self.num_copies, -1).copy())
            for key, array in arrays.items()
        }
        if PROGRESS in columns:
            columns[PROGRESS] = columns[PROGRESS].float()
        return TensorDict(columns, batch_size=self.batch_size, device=self.device)

    def get_extra_state(self) -> dict[str, torch.Tensor]:
        """What a continuation needs, as CPU tensors (`weights_only=True`-safe)."""
        arrays = self._saved() | {
            "seed": np.asarray(self._seed, dtype=np.int64),
            "episodes": self._episodes,
        }
        return {key: torch.from_numpy(np.array(value)) for key, value in arrays.items()}

    def set_extra_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Continue from what `get_extra_state` returned.

        Raises:
            KeyError: An entry is missing.
            ValueError: It was taken with another number of copies.
        """
        arrays = {key: value.cpu().numpy().copy() for key, value in state.items()}
        count = len(arrays["episodes"])
        if count != self.num_copies:
            raise ValueError(
                f"this state holds {count} {self._called}, and there are {self.num_copies}: set "
                f"env.num_envs={count}"
            )
        self._restore(arrays)
        self._seed = int(arrays["seed"])
        self._episodes = arrays["episodes"]

    @abstractmethod
    def _saved(self) -> dict[str, Array]:
        """The state of the copies and of their episodes, by key."""

    @abstractmethod
    def _restore(self, arrays: Mapping[str, Array]) -> None:
        """Continue from what `_saved` returned; the arrays are this environment's."""


def chosen_copies(tensordict: TensorDictBase | None, mask: str, count: int) -> NDArray[np.int64]:
    """The copies that a mask of TorchRL's chooses (``_reset`` or ``_step``): all without one."""
    chosen = None if tensordict is None else tensordict.get(mask, None)
    if chosen is None:
        return np.arange(count)
    return np.flatnonzero(chosen.reshape(-1).cpu().numpy())


def fresh_seed() -> int:
    """Fresh entropy, below 2**63: not reproducible."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0]) >> 1
