"""An update whose losses or parameters are not finite is the last one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from pipeline.finite import described, finite
from pipeline.non_finite import NonFiniteError

HEALTH = "finite"
"""Of an update's results: a number that is finite if its losses and parameters are."""
LATE = 16
"""Updates that an accelerator may be behind with its answer before its host waits for it."""
HUGE = 1e9
"""From such entries of a batch on, their squares are a likely cause."""


@dataclass(frozen=True)
class Network:
    """What an update changes.

    Attributes:
        name: as in the loss.
        parameters: by name.
        losses: that it learns from, their names among an update's results by term.
        rate: the key of its learning rate.
    """

    name: str
    parameters: Mapping[str, nn.Parameter]
    losses: Mapping[str, str]
    rate: str


@dataclass(frozen=True)
class GuardedUpdate:
    """One update, and what it came to.

    Attributes:
        number: from 1, over the whole run.
        health: [], finite if losses and parameters are.
        batch: that it learned from.
        found: its detached scalars by name.
    """

    number: int
    health: Tensor
    batch: TensorDictBase
    found: Mapping[str, Tensor]


class UpdateGuard:
    """Watches updates; on a processor each at once, on an accelerator without waiting for it.

    There the answer is copied while the next updates are launched, and read when it is there:
    a few updates later, but before anything is saved or judged (:meth:`settle`).

    Args:
        networks: What updates change, in the order in which they do.
    """

    def __init__(self, networks: Sequence[Network]) -> None:
        self.networks = networks
        self._open: deque[tuple[GuardedUpdate, Tensor, torch.cuda.Event]] = deque()

    def health(self, found: Mapping[str, Tensor], parameters: Iterable[Tensor]) -> Tensor:
        """A number [] that is finite if the ``parameters`` and the losses in ``found`` are."""
        losses = [key for network in self.networks for key in network.losses.values()]
        return finite([*(found[key] for key in losses if key in found), *parameters])

    def watch(self, update: GuardedUpdate) -> None:
        """Takes the update that was just made.

        Raises:
            NonFiniteError: If it, or one before it, was not finite.
        """
        if update.health.device.type != "cuda":
            self._judge(update, update.health)
            return
        answer = update.health.to("cpu", non_blocking=True)
        arrived = torch.cuda.Event()
        arrived.record()
        self._open.append((update, answer, arrived))
        while self._open and (self._open[0][2].query() or len(self._open) > LATE):
            self._settle_one()

    def settle(self) -> None:
        """Waits for all answers.

        Raises:
            NonFiniteError: If one of the updates was not finite.
        """
        while self._open:
            self._settle_one()

    def _settle_one(self) -> None:
        update, answer, arrived = self._open.popleft()
        arrived.synchronize()
        self._judge(update, answer)

    def _judge(self, update: GuardedUpdate, health: Tensor) -> None:
        if not health.isfinite():
            raise NonFiniteError(self._explained(update), update.batch)

    def _explained(self, update: GuardedUpdate) -> str:
        """The earliest of what is not finite: batch; then losses and parameters, by network."""
        at = f"in update {update.number}"
        for key, values in update.batch.items(include_nested=True, leaves_only=True):
            if not values.isfinite().all():
                name = ".".join(key) if isinstance(key, tuple) else key
                return (
                    f"{name} of the batch is {described(values)} {at}: what was collected is "
                    "finite, so look at the demonstrations, at loss.reward_scale and at "
                    "loss.progress_bonus."
                )
        for network in self.networks:
            for term, metric in network.losses.items():
                if metric in update.found and not update.found[metric].isfinite():
                    value = update.found[metric].item()
                    cause = self._cause(update, network.rate)
                    return f"the loss of term '{term}' ({metric}) is {value} {at}: {cause}"
            for name, values in network.parameters.items():
                if not values.isfinite().all():
                    return self._of_parameter(network, name, values, update)
        return (
            f"losses and parameters add up to more than float32 holds {at}: {self._cause(update)}"
        )

    def _of_parameter(
        self, network: Network, name: str, values: Tensor, update: GuardedUpdate
    ) -> str:
        gradient = network.parameters[name].grad
        norms = [k for k, v in update.found.items() if "grad_norm" in k and not v.isfinite()]
        if norms:
            what = f"a gradient ({', '.join(norms)}) is not finite"
        elif gradient is not None and gradient.isfinite().all():
            what = f"the gradient is finite, so the step was too long: lower {network.rate}"
        else:
            what = "the losses are finite, so it is their gradient"
        return (
            f"{network.name}.{name} is {described(values)} after update {update.number}: {what}; "
            f"{self._cause(update, network.rate)}"
        )

    def _cause(self, update: GuardedUpdate, rate: str = "the learning rates") -> str:
        sizes = {
            ".".join(key) if isinstance(key, tuple) else key: values.abs().max().item()
            for key, values in update.batch.items(include_nested=True, leaves_only=True)
            if values.is_floating_point()
        }
        key, size = max(sizes.items(), key=lambda found: found[1])
        if size > HUGE:
            return (
                f"{key} of the batch is as large as {size:.3g}, too much to be squared: scale it."
            )
        return f"training has diverged: lower {rate}, or set optim.max_grad_norm."
