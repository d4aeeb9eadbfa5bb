"""Adam, its steps, the schedule of its rate, and steps that can be recorded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.optim.adam import adam
from torch.optim.lr_scheduler import ConstantLR, LambdaLR, LRScheduler

from losses import CosineWeight


def make_adam(groups: Iterable[tuple[Iterable[nn.Parameter], float]]) -> torch.optim.Adam:
    """Fused Adam over groups of parameters, each with its own rate."""
    return torch.optim.Adam(
        [{"params": list(parameters), "lr": lr} for parameters, lr in groups], fused=True
    )


class AdamStep:
    """Steps of an optimizer from :func:`make_adam`: the same numbers in less time.

    ``Optimizer.step`` looks up each parameter's moments, the hooks and the profiler at every call,
    which on small networks takes longer than the arithmetic (docs/performance.md). Its functional
    form is called here on lists that are made once, and again after ``load_state_dict``.
    """

    def __init__(self, optimizer: torch.optim.Adam) -> None:
        self._optimizer = optimizer
        self._groups: list[_Group] = []
        optimizer.register_load_state_dict_post_hook(lambda _optimizer: self._groups.clear())

    @torch.no_grad()
    def __call__(self) -> None:
        """One step along the parameters' ``grad``; the first one decides which of them learn."""
        if self._groups:
            for group in self._groups:
                group.step()
            return
        # It makes the moments, for parameters that have a gradient.
        self._optimizer.step()
        found = [_Group.of(group, self._optimizer) for group in self._optimizer.param_groups]
        self._groups = [group for group in found if group.parameters]


@dataclass(frozen=True)
class _Group:
    settings: Mapping[str, Any]
    parameters: list[Tensor]
    moments: list[Tensor]
    squares: list[Tensor]
    steps: list[Tensor]

    @classmethod
    def of(cls, settings: Mapping[str, Any], optimizer: torch.optim.Optimizer) -> Self:
        parameters = [p for p in settings["params"] if p in optimizer.state]
        state = [optimizer.state[parameter] for parameter in parameters]
        moments, squares, steps = (
            [of_one[name] for of_one in state] for name in ("exp_avg", "exp_avg_sq", "step")
        )
        return cls(settings, parameters, moments, squares, steps)

    def step(self) -> None:
        settings = self.settings  # looked up at each step: a schedule changes the rate
        beta1, beta2 = settings["betas"]
        adam(
            self.parameters,
            # All have one: a parameter without has no moments.
            [p.grad for p in self.parameters if p.grad is not None],
            self.moments,
            self.squares,
            [],
            self.steps,
            fused=True,
            capturable=settings["capturable"],
            amsgrad=False,
            beta1=beta1,
            beta2=beta2,
            lr=settings["lr"],
            weight_decay=settings["weight_decay"],
            eps=settings["eps"],
            maximize=False,
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
