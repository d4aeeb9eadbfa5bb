"""Training without an environment, inside the same trainer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tensordict import TensorDict


class OfflineStream:
    """Stands where the trainer expects a collector and yields empty batches.

    A "frame" of an offline run is one update on demonstrations, so the trainer's counters, log
    intervals, evaluations and checkpoints mean the same as online.

    Args:
        updates_per_batch: Updates between two looks of the trainer at its hooks.
    """

    init_random_frames = 0

    def __init__(self, updates_per_batch: int) -> None:
        self.updates_per_batch = updates_per_batch

    def __iter__(self) -> Iterator[TensorDict]:
        while True:
            yield TensorDict({}, batch_size=[self.updates_per_batch])

    def shutdown(self) -> None:
        """Nothing to stop."""

    def state_dict(self) -> dict[str, Any]:
        """Nothing to remember."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Nothing to restore."""
