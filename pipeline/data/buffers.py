"""The replay buffers: main, demonstrations, and demonstrations that grow.

All three are TorchRL ``TensorDictReplayBuffer``s of the same rows (see ``rows.py``).  The
demonstration distribution D of the paper is the union of the fixed core and the grown part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import ImmutableDatasetWriter, LazyTensorStorage, TensorDictReplayBuffer

from pipeline.data.rows import joined


class RowStorage(LazyTensorStorage):
    """Rows, of which many are read at a time.

    ``index_select`` gives what indexing with a tensor gives, which is what the base class does, in
    a fifth of the time (docs/performance.md).
    """

    def get(self, index: Any) -> TensorDictBase:
        """The rows at ``index``: a vector of positions, or whatever else indexes a tensor."""
        if not (isinstance(index, Tensor) and index.dtype == torch.long and index.ndim == 1):
            return super().get(index)
        rows: TensorDictBase = super().get(slice(None))
        index = index.to(rows.device)
        return rows.apply(lambda column: column.index_select(0, index), batch_size=index.shape)


def make_buffer(capacity: int, device: torch.device | str = "cpu") -> TensorDictReplayBuffer:
    """A ring of ``capacity`` rows sampled uniformly with replacement."""
    return TensorDictReplayBuffer(storage=RowStorage(capacity, device=device))


def newest(buffer: TensorDictReplayBuffer, count: int) -> Tensor:
    """Positions of the ``count`` newest rows of a ring, or of all if there are fewer; newest first.

    Args:
        buffer: Of :func:`make_buffer`; ``buffer[positions]`` are the rows.
        count: Not negative.
    """
    rows = len(buffer)
    return (buffer.writer._cursor - 1 - torch.arange(min(count, rows))) % max(rows, 1)


def make_core_buffer(
    rows: TensorDictBase, device: torch.device | str = "cpu"
) -> TensorDictReplayBuffer:
    """A read-only buffer that holds exactly ``rows`` [R].

    Raises:
        ValueError: If there are no rows.
    """
    if rows.shape[0] == 0:  # numel() of an empty TensorDict is 1
        raise ValueError("The demonstrations hold no transitions; check demos.source.")
    storage = RowStorage(rows.shape[0], device=device)
    storage.set(range(rows.shape[0]), rows.to(device))
    return TensorDictReplayBuffer(storage=storage, writer=ImmutableDatasetWriter())


@dataclass(frozen=True)
class EpisodeRecord:
    """Provenance of one grown episode."""

    source: str
    """Who acted: ``policy`` (SID) or ``bc_model`` (ILD)."""
    length: int
    """Rows."""
    episode_return: float
    """Undiscounted sum of the task's rewards."""
    success: bool | None
    """Whether it succeeded; None where the task does not tell."""
    max_progress: float
    """Largest progress, in the task's unit; NaN where the task has none."""
    frame: int
    """Training frames collected when it was admitted; its age is the difference to now."""


class GrownDemonstrations:
    """Whole episodes admitted to D after the start (paper, sections III-E and III-E.1).

    The rows live in a ring: when it is full, the oldest episode's rows are overwritten first, and
    an episode's record goes with its first row.

    Args:
        capacity: Rows.
        device: Where the rows are kept.
    """

    def __init__(self, capacity: int, device: torch.device | str = "cpu") -> None:
        self.capacity = capacity
        self.buffer = make_buffer(capacity, device)
        self.records: deque[EpisodeRecord] = deque()

    def __len__(self) -> int:
        return len(self.buffer)

    def add(self, rows: TensorDictBase, record: EpisodeRecord) -> None:
        """Admits one episode's rows [T].

        Raises:
            ValueError: If the episode is longer than the capacity.
        """
        if rows.shape[0] > self.capacity:
            raise ValueError(
                f"An episode of {rows.shape[0]} rows does not fit in growth.capacity="
                f"{self.capacity}."
            )
        self.buffer.extend(rows)
        self.records.append(record)
        while sum(r.length for r in self.records) > self.capacity:
            self.records.popleft()

    def state_dict(self) -> dict[str, Any]:
        """Records only; the checkpoint stores the ring itself with TorchRL's own adapter."""
        return {"records": [asdict(record) for record in self.records]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.records = deque(EpisodeRecord(**record) for record in state["records"])


class DemonstrationDistribution:
    """The paper's D: the core demonstrations and the grown ones, uniform over all their rows.

    Deviation: with ``grown_share``, the grown part has that share of the rows once its ring is
    full, and as much less as it is emptier; ``None`` is the paper's union.

    Args:
        core: Read-only buffer of the given demonstrations.
        grown: Episodes that joined later, if the variant has any.
        grown_share: Of the rows drawn, in [0, 1].

    Raises:
        ValueError: If the share is out of range.
    """

    def __init__(
        self,
        core: TensorDictReplayBuffer,
        grown: GrownDemonstrations | None = None,
        grown_share: float | None = None,
    ) -> None:
        if grown_share is not None and not 0.0 <= grown_share <= 1.0:
            raise ValueError(f"growth.share must be in [0, 1] or null, got {grown_share}.")
        self.core = core
        self.grown = grown
        self.grown_share = grown_share

    def __len__(self) -> int:
        return len(self.core) + (len(self.grown) if self.grown is not None else 0)

    def sample(self, n: int) -> TensorDictBase:
        """Draws ``n`` rows with replacement; the grown part gets its share."""
        return self.sample_batches(1, n).squeeze(0)

    def sample_batches(self, batches: int, n: int) -> TensorDictBase:
        """Draws ``[batches, n]`` rows with replacement, the core's first in each batch.

        The grown part's share of n is rounded up or down at random so that it is exact on average.
        """
        expected = n * self._share()
        n_grown = min(n, int(expected + torch.rand(()).item())) if expected else 0
        parts: Sequence[TensorDictBase] = [
            buffer.sample(batches * count).reshape(batches, count)
            for buffer, count in zip(self._buffers(), (n - n_grown, n_grown), strict=False)
            if count > 0
        ]
        return joined(parts, dim=1)

    def _share(self) -> float:
        """Of the grown rows among those drawn."""
        if self.grown is None:
            return 0.0
        if self.grown_share is None:
            return len(self.grown) / len(self)
        return self.grown_share * len(self.grown) / self.grown.capacity

    def _buffers(self) -> list[TensorDictReplayBuffer]:
        return [self.core] if self.grown is None else [self.core, self.grown.buffer]
