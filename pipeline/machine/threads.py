"""Torch's threads make room for the simulator's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch to the calling thread.

    Others would spin after each product, on the cores that physics waits for: an evaluation took
    7 % longer on two idle cores, and twice as long beside other work; collecting took 60 % longer
    (docs/performance.md).
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class OneThreadCollector(Collector):
    """TorchRL's collector, whose policy runs in the calling thread alone."""

    def rollout(self) -> TensorDictBase:
        """A batch of frames; see :meth:`torchrl.collectors.Collector.rollout`."""
        with one_torch_thread():
            return super().rollout()
