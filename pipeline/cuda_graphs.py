"""Updates that an NVIDIA GPU replays as one graph of kernels."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

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


def set_capturable(optimizer: torch.optim.Optimizer, capturable: bool) -> None:
    """Make an optimizer's steps fit for recording, or ordinary again.

    Recorded steps read their rates from the GPU's memory, where a schedule changes them in place.
    Loading a state brings its own kind of rates along: call this again afterwards.
    """
    device = optimizer.param_groups[0]["params"][0].device
    for group in optimizer.param_groups:
        rate: Any = float(group["lr"])
        # The fused kernel reads a float32.
        at_hand = torch.tensor(rate, dtype=torch.float32, device=device) if capturable else rate
        group["lr"] = at_hand
        group["capturable"] = capturable
    # It would warn that capturable steps run without a recording: the first two of each layout do.
    optimizer._warned_capturable_if_run_uncaptured = True
