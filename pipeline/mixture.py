"""Exact-count mixture of the main buffer and the demonstration distribution D."""

from __future__ import annotations

import tensordict
import torch
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from pipeline.buffers import DemonstrationDistribution


class Mixture:
    """Draws batches with a fixed number of rows from each source and marks D's rows ``is_demo``.

    TorchRL's ``ReplayBufferEnsemble`` picks a *buffer* for each equal sub-batch, so a row split
    other than 1:1 holds only on average; here it holds in every batch, main rows first.

    Args:
        main: Replay buffer of collected experience, or None for training on D alone.
        demos: The distribution D, or None for plain reinforcement learning.
        main_rows: Rows of a batch drawn from ``main``.
        demo_rows: Rows of a batch drawn from ``demos``.
        device: Where the batch goes.

    Raises:
        ValueError: If a count is negative, no rows are asked for, or rows are asked of a source
            that is not there.
    """

    def __init__(
        self,
        main: TensorDictReplayBuffer | None,
        demos: DemonstrationDistribution | None,
        *,
        main_rows: int,
        demo_rows: int,
        device: torch.device | str = "cpu",
    ) -> None:
        for name, rows, source in (("main", main_rows, main), ("demo", demo_rows, demos)):
            if rows < 0:
                raise ValueError(f"{name}_rows must not be negative, got {rows}.")
            if rows > 0 and source is None:
                raise ValueError(
                    f"{rows} {name} rows are asked for but there is no such buffer; "
                    "give the source or ask for 0 rows (sampler.demo_ratio=0)."
                )
        if main_rows + demo_rows == 0:
            raise ValueError("A batch needs rows, but 0 are asked of every source.")
        self.main = main
        self.demos = demos
        self.main_rows = main_rows
        self.demo_rows = demo_rows
        self.device = torch.device(device)
        self.is_demo = torch.zeros(main_rows + demo_rows, 1, dtype=torch.bool, device=self.device)
        self.is_demo[main_rows:] = True

    def sample(self) -> TensorDictBase:
        """One batch ``[main_rows + demo_rows]`` with ``is_demo`` [B, 1]."""
        parts = []
        if self.main is not None and self.main_rows:
            parts.append(self.main.sample(self.main_rows))
        if self.demos is not None and self.demo_rows:
            parts.append(self.demos.sample(self.demo_rows))
        joined: TensorDictBase = tensordict.cat(parts) if len(parts) > 1 else parts[0]
        batch = joined.to(self.device)
        batch.set("is_demo", self.is_demo.clone())
        return batch

    def __call__(self, _batch: TensorDictBase | None = None) -> TensorDictBase:
        """Trainer hook ``process_optim_batch``: the collected batch gives way to a sampled one."""
        return self.sample()
