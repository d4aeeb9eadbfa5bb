"""Updates that an NVIDIA GPU replays as one graph of kernels."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import CudaGraphModule
from torch import Tensor

Update = Callable[[TensorDictBase], dict[str, Tensor]]
"""Learns from a batch and returns detached scalars by name."""


class CudaGraphs:
    """An update, recorded at the second batch of each layout and replayed from the third on.

    An update of small networks is hundreds of kernels that take the GPU less time than their
    launches take its host; a replay launches them all at once.

    Args:
        update: Must not wait for the GPU, and must decide nothing by a number that changes: what it
            reads besides the batch is tensors, and who changes those does so in place.
    """

    def __init__(self, update: Update) -> None:
        self._update = update
        self._recordings: dict[object, _Recording] = {}

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Learns from ``batch``, all of whose entries are on the GPU; results are copies."""
        layout = (batch.batch_size, frozenset(batch.keys(include_nested=True, leaves_only=True)))
        if layout not in self._recordings:
            self._recordings[layout] = _Recording(self._update)
        return self._recordings[layout](batch)


class _Recording:
    def __init__(self, update: Update) -> None:
        self.update = update
        self.names: tuple[str, ...] = ()
        with warnings.catch_warnings():
            # tensordicts leave torch's pytrees here, which nothing in this project needs them in.
            warnings.filterwarnings("ignore", message="Tensordict is registered in PyTree")
            self.graph = CudaGraphModule(self.stacked, in_keys=[])

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        values = self.graph(batch)["values"]
        return dict(zip(self.names, values.unbind(), strict=True))

    def stacked(self, batch: TensorDictBase) -> TensorDict:
        """The results in one tensor: one copy at a replay instead of a dozen."""
        found = self.update(batch)
        self.names = tuple(found)
        return TensorDict({"values": torch.stack(list(found.values()))})


def recorded(update: Update, cuda_graphs: bool) -> Update:
    """``update`` as CUDA graphs, or as it is."""
    return CudaGraphs(update) if cuda_graphs else update
