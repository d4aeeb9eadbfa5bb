"""Exact-count mixture of sources: the main buffer, D, and those of a user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Protocol, runtime_checkable

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDictBase

from pipeline.data.own_sources import OwnSourceEntry
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
    # Sources of your own beside these: path.py:NAME, or {source: path.py:NAME, rows: 64, ...}
    own_sources: tuple[OwnSourceEntry, ...] = ()


class RowSource(Protocol):
    """What rows are drawn from: a replay buffer, D, or a source of a user."""

    def sample(self, count: int, /) -> TensorDictBase:
        """Rows ``[count]``, drawn with replacement."""


@runtime_checkable
class BatchSource(RowSource, Protocol):
    """A source that decides anew for each batch how many rows it takes from where."""

    def sample_batches(self, batches: int, count: int, /) -> TensorDictBase:
        """Rows ``[batches, count]``."""


@dataclass(frozen=True)
class BatchPart:
    """What a batch has of one source.

    Attributes:
        source: Of the rows; None where there is none, for 0 rows.
        rows: Of each batch.
        is_demo: Whether they count as demonstrations.
    """

    source: RowSource | None
    rows: int
    is_demo: bool = False

    def drawn(self, batches: int) -> TensorDictBase:
        """Rows ``[batches, rows]``."""
        if isinstance(self.source, BatchSource):
            return self.source.sample_batches(batches, self.rows)
        assert self.source is not None
        return self.source.sample(batches * self.rows).reshape(batches, self.rows)


class Mixture:
    """Draws batches with a fixed number of rows from each source and marks ``is_demo``.

    TorchRL's ``ReplayBufferEnsemble`` picks a *buffer* for each equal sub-batch, so a row split
    other than 1:1 holds only on average; here it holds in every batch. Rows that count as
    demonstrations come last, as the losses expect; otherwise the order is that of ``parts``, and
    so is the order in which the sources draw.

    Args:
        parts: By the name of their source.
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
        parts: Mapping[str, BatchPart],
        *,
        draws: int = 1,
        device: torch.device | str = "cpu",
    ) -> None:
        if draws < 1:
            raise ValueError(f"draws must be at least 1, got {draws}.")
        for name, part in parts.items():
            if part.rows < 0:
                raise ValueError(f"rows of {name} must not be negative, got {part.rows}.")
            if part.rows > 0 and part.source is None:
                raise ValueError(
                    f"{part.rows} rows of {name} are asked for but there is no such source; "
                    "give the source or ask for 0 rows (of demos: sampler.demo_ratio=0)."
                )
        if not any(part.rows for part in parts.values()):
            raise ValueError("A batch needs rows, but 0 are asked of every source.")
        self.parts = sorted(
            (part for part in parts.values() if part.rows), key=lambda part: part.is_demo
        )
        self.draws = draws
        self.device = torch.device(device)
        marks = [part.is_demo for part in self.parts for _ in range(part.rows)]
        is_demo = torch.tensor(marks, device=self.device).unsqueeze(-1)
        self.is_demo = is_demo.repeat(draws, 1, 1)
        self._ready: list[TensorDictBase] = []
        self._collected: TensorDictBase | None = None

    def sample(self) -> TensorDictBase:
        """One batch ``[B]`` of all parts with ``is_demo`` [B, 1]."""
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
        """Batches ``[draws, B]``, demonstrations last in each."""
        drawn = joined([part.drawn(self.draws) for part in self.parts], dim=1).to(self.device)
        drawn.set("is_demo", self.is_demo.clone())
        return drawn
