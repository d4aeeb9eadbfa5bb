"""Exact-count mixture of the main buffer and the demonstration distribution D."""

from __future__ import annotations

from typing import Annotated

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from pipeline.data.buffers import DemonstrationDistribution
from pipeline.data.rows import joined
from pipeline.settings import STRICT, Count, NotNegative, Rate

Ratio = Annotated[Rate, Field(le=1000.0)]
"""Beyond it a batch is nothing but demonstrations, and memory ends."""
DRAWS = 16
"""Batches drawn at a time where many updates follow one another; more gained nothing."""


@settings(frozen=True, kw_only=True, config=STRICT)
class SamplerSettings:
    """Exact row counts of one batch."""

    batch_size: Count = 1024  # rows from the replay buffer
    capacity: Count | None = None  # rows the replay buffer holds, the newest; None = the whole run
    demo_ratio: Ratio = 0.0  # rows from the demonstration distribution D per row of batch_size
    preload: bool = False  # the demonstrations lie in the replay buffer from the start (DDPGfD)
    demo_update_period: NotNegative = 0  # f of Algorithm 1: an extra update on D every f; 0 = never


class Mixture:
    """Draws batches with a fixed number of rows from each source and marks D's rows ``is_demo``.

    TorchRL's ``ReplayBufferEnsemble`` picks a *buffer* for each equal sub-batch, so a row split
    other than 1:1 holds only on average; here it holds in every batch, main rows first.

    Args:
        main: Replay buffer of collected experience, or None for training on D alone.
        demos: The distribution D, or None for plain reinforcement learning.
        main_rows: Rows of a batch drawn from ``main``.
        demo_rows: Rows of a batch drawn from ``demos``.
        draws: Batches drawn at a time, at least 1. Rows are drawn with replacement, so K batches
            drawn together are K batches drawn one by one, at a fraction of the calls; they must
            all be used before the sources change, or be thrown away with :meth:`renew`.
        device: Where the batch goes.

    Raises:
        ValueError: If a count is out of range, no rows are asked for, or rows are asked of a
            source that is not there.
    """

    def __init__(
        self,
        main: TensorDictReplayBuffer | None,
        demos: DemonstrationDistribution | None,
        *,
        main_rows: int,
        demo_rows: int,
        draws: int = 1,
        device: torch.device | str = "cpu",
    ) -> None:
        if draws < 1:
            raise ValueError(f"draws must be at least 1, got {draws}.")
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
        self.draws = draws
        self.device = torch.device(device)
        is_demo = torch.zeros(main_rows + demo_rows, 1, dtype=torch.bool, device=self.device)
        is_demo[main_rows:] = True
        self.is_demo = is_demo.repeat(draws, 1, 1)
        self._ready: list[TensorDictBase] = []
        self._collected: TensorDictBase | None = None

    def sample(self) -> TensorDictBase:
        """One batch ``[main_rows + demo_rows]`` with ``is_demo`` [B, 1]."""
        if not self._ready:
            self._ready = list(self._draw().unbind(0))
        return self._ready.pop()

    @property
    def drawn(self) -> list[TensorDictBase]:
        """Batches that are drawn and not used yet, the next one last."""
        return self._ready

    @property
    def collected(self) -> TensorDictBase | None:
        """For which portion they are drawn."""
        return self._collected

    def go_on(self, drawn: list[TensorDictBase], collected: TensorDictBase) -> None:
        """Hands out ``drawn`` first, as if it had drawn them for the portion ``collected``."""
        self._ready = [batch.to(self.device) for batch in drawn]
        self._collected = collected

    def renew(self) -> None:
        """Throws away batches that were drawn but not used: the sources have changed."""
        self._ready = []

    def __call__(self, collected: TensorDictBase | None = None) -> TensorDictBase:
        """Trainer hook ``process_optim_batch``: the collected batch gives way to a sampled one.

        The sources change when frames are collected, so each collected batch renews the draw.
        """
        if collected is not self._collected:
            self._collected = collected
            self.renew()
        return self.sample()

    def _draw(self) -> TensorDictBase:
        """Batches ``[draws, main_rows + demo_rows]``, the main rows first in each."""
        parts = []
        if self.main is not None and self.main_rows:
            rows = self.main.sample(self.draws * self.main_rows)
            parts.append(rows.reshape(self.draws, self.main_rows))
        if self.demos is not None and self.demo_rows:
            parts.append(self.demos.sample_batches(self.draws, self.demo_rows))
        drawn = joined(parts, dim=1).to(self.device)
        drawn.set("is_demo", self.is_demo.clone())
        return drawn
