"""What a checkpoint gives back."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchrl.checkpoint import Checkpoint
from torchrl.data import TensorDictReplayBuffer

from pipeline.data.buffers import make_buffer
from pipeline.files.checkpoint import make_checkpoint
from tests.pipeline.toys import tagged_rows


@pytest.mark.parametrize(("stored", "capacity"), [(3, 5), (7, 5), (7, 9)])
def test_a_ring_goes_on_where_it_was(stored: int, capacity: int, tmp_path: Path):
    def checkpoint(buffer: TensorDictReplayBuffer) -> Checkpoint:
        return make_checkpoint(torch.nn.Linear(1, 1), buffer)

    def tags(buffer: TensorDictReplayBuffer) -> list[float]:
        return buffer[:]["observation"][:, 0].tolist()

    first = make_buffer(5)
    for tag in range(stored):
        first.extend(tagged_rows(float(tag), 1))
    checkpoint(first).save(tmp_path / "saved")
    second = make_buffer(capacity)
    second.extend(tagged_rows(99.0, 2))
    checkpoint(second).load(tmp_path / "saved")
    assert tags(second) == tags(first)
    for buffer in (first, second):
        buffer.extend(tagged_rows(50.0, 1))
    larger = [5.0, 6.0, 2.0, 3.0, 4.0, 50.0]
    assert tags(second) == (larger if capacity == 9 else tags(first))
