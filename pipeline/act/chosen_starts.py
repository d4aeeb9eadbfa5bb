"""An environment that tells when its episodes begin, and may be told where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Unbounded
from torchrl.envs import EnvBase

from pipeline.files.checkpoint import resumes_midway

IS_INIT: Final = "is_init"
"""[N, 1] bool, written with every observation: an episode begins with it (TorchRL's name)."""
BEGUN_AT: Final = "begun_at"
"""[N, 2] int64, written with every observation: demonstration and step at which the episode
began; -1 where it began as the task's own do."""


class Begin(Protocol):
    """Says where episodes begin."""

    def __call__(self, count: int) -> tuple[TensorDictBase, Tensor] | None:
        """What to reset ``count`` copies with [count], and where that is [count, 2].

        None where they begin as the task's own episodes do.
        """
        ...


class ChosenStartsEnv(EnvBase):
    """``base`` as it is, whose episodes begin where ``begin`` says.

    Args:
        base: Of batch size [N].
        begin: Asked at every reset, the automatic ones included; None leaves it to ``base``.
    """

    def __init__(self, base: EnvBase, begin: Begin | None = None) -> None:
        super().__init__(device=base.device, batch_size=base.batch_size)
        self.base = base
        self.begin = begin
        count = base.batch_size[0]
        self.observation_spec = base.observation_spec.clone()
        self.observation_spec[IS_INIT] = Binary(
            shape=(count, 1), dtype=torch.bool, device=base.device
        )
        self.observation_spec[BEGUN_AT] = Unbounded(
            (count, 2), dtype=torch.int64, device=base.device
        )
        self.action_spec = base.action_spec.clone()
        self.reward_spec = base.reward_spec.clone()
        self.done_spec = base.full_done_spec.clone()
        self._at = torch.full((count, 2), -1, dtype=torch.int64, device=base.device)

    @property
    def resumes_midway(self) -> bool:
        """As ``base`` does."""
        return resumes_midway(self.base)

    def _set_seed(self, seed: int | None) -> None:
        self.base.set_seed(seed)

    def _reset(self, tensordict: TensorDictBase | None, **options: Any) -> TensorDictBase:
        td = TensorDict({}, self.batch_size, device=self.device)
        if tensordict is not None:
            td.update(tensordict)
        begins = td.get("_reset", torch.ones_like(self._at[:, :1], dtype=torch.bool)).reshape(-1)
        chosen = begins.nonzero().squeeze(-1)
        told = None if self.begin is None else self.begin(len(chosen))
        self._at[chosen] = -1
        if told is not None:
            starts, self._at[chosen] = told[0].to(self.device), told[1].to(self.device)
            for key, values in starts.items():
                placed = values.new_zeros(len(begins), *values.shape[1:])
                placed[chosen] = values
                td[key] = placed
        return self._told(self.base._reset(td, **options), begins)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = self.base._step(tensordict)
        return self._told(after, torch.zeros_like(self._at[:, 0], dtype=torch.bool))

    def _told(self, seen: TensorDictBase, begins: Tensor) -> TensorDictBase:
        return seen.set(IS_INIT, begins.unsqueeze(-1).clone()).set(BEGUN_AT, self._at.clone())

    def get_extra_state(self) -> dict[str, Tensor]:
        """Where the open episodes began; the rest is the state of ``base``, beside it."""
        return {BEGUN_AT: self._at.clone()}

    def set_extra_state(self, state: Mapping[str, Tensor]) -> None:
        """Continue from what `get_extra_state` returned."""
        self._at = state[BEGUN_AT].to(self._at)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close ``base``."""
        super().close(raise_if_closed=raise_if_closed)
        self.base.close(raise_if_closed=raise_if_closed)
