"""Adam, its steps, the schedule of its rate, and steps that can be recorded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from pydantic.dataclasses import dataclass as settings
from torch import Tensor, nn
from torch.fx.experimental.proxy_tensor import get_proxy_mode
from torch.optim.adam import adam
from torch.optim.lr_scheduler import LambdaLR

from losses import CosineWeight
from pipeline.settings import STRICT, Count, NotNegative, Positive, Rate, Share


@settings(frozen=True, kw_only=True, config=STRICT)
class OptimSettings:
    """Optimizers and the schedule of updates."""

    actor_lr: Rate = 1e-5
    critic_lr: Rate = 1e-5
    temperature_lr: Rate = 1e-5
    updates_per_frame: Positive = 1.0  # of what all copies collect together
    actor_period: Count = 1  # critic updates per actor and temperature update
    target_period: Count = 2  # critic updates per target update
    actor_delay: NotNegative = 0  # critic updates before the first actor update (critic warm-up)
    max_grad_norm: Positive | None = None
    actor_average: Share | None = None  # evaluate an average of the weights; kept per update
    actor_average_share: Share | None = None  # instead: the share of the run's updates it spans
    anneal_actor: bool = False  # cosine from actor_lr to 0 over the run
    diagnostics_period: Count = 100  # actor updates between gradient diagnostics


LEAST_RATE = 1e-30
"""In place of 0, by which torch's arithmetic of Adam divides: a weight that never had a gradient
would be 0/0. It is far below what float32 can add to a weight, and its inverse no infinity."""


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

    Args:
        optimizer: Every parameter of it that is not frozen has a gradient whenever a step is made.
    """

    def __init__(self, optimizer: torch.optim.Adam) -> None:
        self._optimizer = optimizer
        self._groups: list[_Group] = []
        self._state: list[Tensor] = []
        optimizer.register_load_state_dict_post_hook(lambda _optimizer: self._groups.clear())

    def state(self) -> list[Tensor]:
        """What a step works on: parameters, their moments and counts of steps, rates in memory."""
        if not self._groups:
            _make_moments(self._optimizer)
            found = [_Group.of(group, self._optimizer) for group in self._optimizer.param_groups]
            self._groups = [group for group in found if group.parameters]
            self._state = [tensor for group in self._groups for tensor in group.state()]
        return self._state

    @torch.no_grad()
    def __call__(self) -> None:
        """One step along the parameters' ``grad``.

        For a tracer it is arithmetic, which a compiler can make part of an update's loops;
        otherwise it is torch's kernel.
        """
        self.state()
        traced = get_proxy_mode() is not None
        for group in self._groups:
            group.step(as_arithmetic=traced)


def _make_moments(optimizer: torch.optim.Adam) -> None:
    """Give the parameters that learn what ``Adam`` itself gives them at its first step alone.

    Of zero gradients that step changes nothing but the counts, which are set back.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    new = [p for p in parameters if p.requires_grad and p not in optimizer.state]
    if not new:
        return
    gradients = [parameter.grad for parameter in parameters]
    for parameter in parameters:
        parameter.grad = None
    for parameter in new:
        parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient
    for parameter in new:
        optimizer.state[parameter]["step"].zero_()


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

    def state(self) -> list[Tensor]:
        rate = self.settings["lr"]
        in_memory = [rate] if isinstance(rate, Tensor) else []
        return [*self.parameters, *self.moments, *self.squares, *self.steps, *in_memory]

    def step(self, *, as_arithmetic: bool) -> None:
        settings = self.settings  # looked up at each step: a schedule changes the rate
        beta1, beta2 = settings["betas"]
        rate = settings["lr"]
        if as_arithmetic:
            in_memory = isinstance(rate, Tensor)
            rate = rate.clamp_min(LEAST_RATE) if in_memory else max(rate, LEAST_RATE)
        adam(
            self.parameters,
            # All have one: a parameter without has no moments.
            [p.grad for p in self.parameters if p.grad is not None],
            self.moments,
            self.squares,
            [],
            self.steps,
            fused=not as_arithmetic,
            foreach=False,
            # The form for gradients of gradients is the one that reads no number off a tensor.
            differentiable=as_arithmetic,
            capturable=settings["capturable"],
            amsgrad=False,
            beta1=beta1,
            beta2=beta2,
            lr=rate,
            weight_decay=settings["weight_decay"],
            eps=settings["eps"],
            maximize=False,
        )


def make_annealing(optimizer: torch.optim.Optimizer, updates: int | None) -> LambdaLR:
    """The schedule of the first group's rate, constant for None; the rates of the others stay."""
    others = [lambda _update: 1.0] * (len(optimizer.param_groups) - 1)
    if updates is None:
        return LambdaLR(optimizer, [lambda _update: 1.0, *others])
    # Not CosineAnnealingLR, whose rate rises again if there are more updates than that.
    share = CosineWeight(init=1.0, final=0.0, duration=max(updates, 1))
    return LambdaLR(optimizer, [lambda update: share(update), *others])


def load_adam(
    optimizer: torch.optim.Optimizer,
    state: dict[str, Any],
    annealing: LambdaLR | None = None,
    annealing_state: dict[str, Any] | None = None,
) -> None:
    """Restore moments and the place in a schedule, at the rates that the optimizer was made with.

    torch restores the saved rates too: others, asked for when a run is resumed, would be ignored.
    Rates are numbers afterwards; see :func:`set_recordable`.

    Args:
        optimizer: Of :func:`make_adam`, with ``annealing`` its schedule if it has one.
        state: Of its ``state_dict``.
        annealing: Of :func:`make_annealing`.
        annealing_state: Of its ``state_dict``.
    """
    groups = optimizer.param_groups
    rates = [float(group.get("initial_lr", group["lr"])) for group in groups]
    optimizer.load_state_dict(state)
    shares = [1.0] * len(rates)
    if annealing is not None and annealing_state is not None:
        annealing.load_state_dict(annealing_state)
        annealing.base_lrs = [*rates]
        shares = [share(annealing.last_epoch) for share in annealing.lr_lambdas]
    for group, rate, share in zip(optimizer.param_groups, rates, shares, strict=True):
        group["lr"] = rate * share
        if annealing is not None:
            group["initial_lr"] = rate


def set_recordable(
    optimizer: torch.optim.Optimizer, *, recorded: bool, compiled: bool = False
) -> None:
    """Make an optimizer's steps fit for being recorded or compiled, or ordinary again.

    Such steps read their rates from memory, where a schedule changes them in place. Loading a
    state brings its own kind of rates along: call this again afterwards.
    """
    device = optimizer.param_groups[0]["params"][0].device
    # The fused kernel of a GPU reads a float32.
    dtype = torch.float64 if device.type == "cpu" else torch.float32
    for group in optimizer.param_groups:
        rate: Any = float(group["lr"])
        in_memory = torch.tensor(rate, dtype=dtype, device=device)
        group["lr"] = in_memory if recorded or compiled else rate
        group["capturable"] = recorded
    # It would warn that capturable steps run without a recording: the first two of each layout do.
    optimizer._warned_capturable_if_run_uncaptured = True
