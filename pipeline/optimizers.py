"""Adam, the schedule of its rate, and steps that can be recorded."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import nn
from torch.optim.lr_scheduler import ConstantLR, LambdaLR, LRScheduler

from losses import CosineWeight


def make_adam(groups: Iterable[tuple[Iterable[nn.Parameter], float]]) -> torch.optim.Adam:
    """Fused Adam over groups of parameters, each with its own rate."""
    return torch.optim.Adam(
        [{"params": list(parameters), "lr": lr} for parameters, lr in groups], fused=True
    )


def make_annealing(optimizer: torch.optim.Optimizer, updates: int | None) -> LRScheduler:
    """The schedule of the first group's rate; the rates of the others stay."""
    if updates is None:
        return ConstantLR(optimizer, factor=1.0)
    # Not CosineAnnealingLR, whose rate rises again if there are more updates than that.
    share = CosineWeight(init=1.0, final=0.0, duration=max(updates, 1))
    others = len(optimizer.param_groups) - 1
    return LambdaLR(optimizer, [lambda update: share(update), *[lambda _update: 1.0] * others])


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
