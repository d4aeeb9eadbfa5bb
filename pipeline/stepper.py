"""What one optimization step does: the order of updates and how the actor's gradients meet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.lr_scheduler import ConstantLR, LambdaLR, LRScheduler
from torchrl.trainers import OptimizationStepper, Trainer

from losses import BCSACLoss, CosineWeight

METRICS = (
    "loss_qvalue",
    "loss_actor",
    "loss_alpha",
    "bc_nll",
    "bc_weight",
    "alpha",
    "entropy",
    "q_data",
    "q_policy",
    "grad_norm_rl",
    "grad_norm_bc",
    "grad_cosine",
)
"""Keys of every step's result; one that a step does not compute keeps its last value."""


@dataclass(frozen=True)
class StepRhythm:
    """When each part of a step happens, counted in critic updates."""

    actor_period: int = 1
    target_period: int = 2
    actor_delay: int = 0
    diagnostics_period: int = 100

    def __post_init__(self) -> None:
        for name in ("actor_period", "target_period", "diagnostics_period"):
            if getattr(self, name) < 1:
                raise ValueError(f"optim.{name} must be at least 1, got {getattr(self, name)}.")
        if self.actor_delay < 0:
            raise ValueError(f"optim.actor_delay must not be negative, got {self.actor_delay}.")


class BCSACStepper(OptimizationStepper):
    """One step: critic, then actor and temperature, then target network.

    The actor's two gradients, of the RL objective and of the imitation term, are added with the
    weight ``lambda(n)`` of the loss (paper III-C, III-D).  With ``bc_gradient_ratio`` the weight is
    ``lambda(n) * ratio * |g_RL| / |g_BC|`` instead: the imitation gradient keeps a fixed size
    relative to the RL gradient, whatever the scale of the rewards.

    Deviation: the ratio is not in the paper, whose fixed lambda lets the share of imitation drift
    by two orders of magnitude during a run; ``loss.bc_gradient_ratio=null`` is the paper's rule.

    Args:
        loss: Terms and networks.
        actor_lr: Adam's rate for the actor; likewise ``critic_lr`` and ``temperature_lr``.
        rhythm: How often each part runs.
        bc_gradient_ratio: None for the paper's fixed weights.
        max_grad_norm: Clips the norm of the actor's and the critic's gradient; None leaves them.
        anneal_updates: Actor updates over which a cosine takes the actor's rate to zero; None
            keeps it constant.
    """

    def __init__(
        self,
        loss: BCSACLoss,
        *,
        actor_lr: float,
        critic_lr: float,
        temperature_lr: float,
        rhythm: StepRhythm | None = None,
        bc_gradient_ratio: float | None = None,
        max_grad_norm: float | None = None,
        anneal_updates: int | None = None,
    ) -> None:
        self.loss = loss
        self.rhythm = rhythm if rhythm is not None else StepRhythm()
        self.bc_gradient_ratio = bc_gradient_ratio
        self.max_grad_norm = max_grad_norm
        self.actor_parameters = list(loss.actor.parameters())
        self.optimizers = {
            "critic": _adam([(loss.critic.parameters(), critic_lr)]),
            # Together, because a step costs a small network more in calls than in arithmetic.
            "actor": _adam([(self.actor_parameters, actor_lr), ([loss.log_alpha], temperature_lr)]),
        }
        self.annealing = _annealing(self.optimizers["actor"], anneal_updates)
        self.critic_updates = 0
        self.last: dict[str, Tensor] = {}

    def step(self, _trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch; returns the detached scalars of ``METRICS``."""
        self._critic_step(sub_batch)
        self.critic_updates += 1
        after_delay = self.critic_updates - self.rhythm.actor_delay
        if after_delay > 0 and after_delay % self.rhythm.actor_period == 0:
            self._actor_step(sub_batch)
        if self.critic_updates % self.rhythm.target_period == 0:
            self.loss.update_target()
        device = sub_batch.device
        nan = torch.full((), float("nan"), device=device)
        return TensorDict({key: self.last.get(key, nan) for key in METRICS}, device=device)

    def _critic_step(self, batch: TensorDictBase) -> None:
        terms = self.loss.critic_terms(batch)
        self.optimizers["critic"].zero_grad()
        terms.loss.backward()
        self._clip(self.loss.critic.parameters())
        self.optimizers["critic"].step()
        self.last.update(loss_qvalue=terms.loss.detach(), q_data=terms.q.mean())

    def _actor_step(self, batch: TensorDictBase) -> None:
        terms = self.loss.actor_terms(batch)
        weight: float | Tensor = self.loss.current_bc_weight
        diagnose = self.loss.updates % self.rhythm.diagnostics_period == 0
        if terms.bc.requires_grad and (self.bc_gradient_ratio is not None or diagnose):
            g_rl = torch.autograd.grad(terms.rl, self.actor_parameters, retain_graph=True)
            g_bc = torch.autograd.grad(terms.bc, self.actor_parameters)
            norm_rl, norm_bc = _norm(g_rl), _norm(g_bc)
            if self.bc_gradient_ratio is not None:
                weight = weight * self.bc_gradient_ratio * norm_rl / norm_bc.clamp_min(1e-12)
            for parameter, rl, bc in zip(self.actor_parameters, g_rl, g_bc, strict=True):
                parameter.grad = rl + weight * bc
            cosine = _dot(g_rl, g_bc) / (norm_rl * norm_bc).clamp_min(1e-12)
            self.last.update(grad_norm_rl=norm_rl, grad_norm_bc=norm_bc, grad_cosine=cosine)
        else:
            self.optimizers["actor"].zero_grad()
            (terms.rl + weight * terms.bc).backward()
        self._clip(self.actor_parameters)
        alpha_loss = self._temperature_gradient(terms.log_prob)
        self.optimizers["actor"].step()
        self.annealing.step()
        self.last.update(
            loss_actor=terms.rl.detach(),
            loss_alpha=alpha_loss,
            bc_nll=terms.bc.detach(),
            bc_weight=torch.as_tensor(weight, dtype=torch.float32, device=alpha_loss.device),
            alpha=self.loss.alpha,
            entropy=-terms.log_prob.mean(),
            q_policy=terms.q.mean(),
        )
        self.loss.advance()

    def _temperature_gradient(self, log_prob: Tensor) -> Tensor:
        loss = self.loss.alpha_loss(log_prob)
        if loss.requires_grad:
            (self.loss.log_alpha.grad,) = torch.autograd.grad(loss, [self.loss.log_alpha])
        return loss.detach()

    def _clip(self, parameters: Iterable[nn.Parameter]) -> None:
        if self.max_grad_norm is not None:
            nn.utils.clip_grad_norm_(parameters, self.max_grad_norm)

    def state_dict(self) -> dict[str, Any]:
        """Optimizer moments, counters and last metrics."""
        return {
            "optimizers": {name: opt.state_dict() for name, opt in self.optimizers.items()},
            "annealing": self.annealing.state_dict(),
            "critic_updates": self.critic_updates,
            "last": dict(self.last),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        self.annealing.load_state_dict(state["annealing"])
        self.critic_updates = state["critic_updates"]
        self.last = dict(state["last"])


class ImitationStepper(OptimizationStepper):
    """One step of behaviour cloning (paper III-B): maximise E_D[log pi(a | s)].

    Args:
        loss: Only its imitation term and actor are used.
        actor_lr: Adam's rate.
        anneal_updates: Updates over which a cosine takes the rate to zero; None keeps it constant.
            The closed-loop success of a constant rate wanders from checkpoint to checkpoint while
            the loss hardly moves; an annealed run ends where the wandering has died down.
    """

    def __init__(
        self, loss: BCSACLoss, *, actor_lr: float, anneal_updates: int | None = None
    ) -> None:
        self.loss = loss
        self.optimizer = _adam([(loss.actor.parameters(), actor_lr)])
        self.annealing = _annealing(self.optimizer, anneal_updates)

    def step(self, _trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch of demonstration rows; returns ``loss_bc``."""
        loss = self.loss.bc_loss(sub_batch)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.annealing.step()
        return TensorDict({"loss_bc": loss.detach()}, device=sub_batch.device)

    def state_dict(self) -> dict[str, Any]:
        """Optimizer moments."""
        return {
            "optimizer": self.optimizer.state_dict(),
            "annealing": self.annealing.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.optimizer.load_state_dict(state["optimizer"])
        self.annealing.load_state_dict(state["annealing"])


def _adam(groups: Iterable[tuple[Iterable[nn.Parameter], float]]) -> torch.optim.Adam:
    return torch.optim.Adam(
        [{"params": list(parameters), "lr": lr} for parameters, lr in groups], fused=True
    )


def _annealing(optimizer: torch.optim.Optimizer, updates: int | None) -> LRScheduler:
    """The schedule of the first group's rate; the rates of the others stay."""
    if updates is None:
        return ConstantLR(optimizer, factor=1.0)
    # Not CosineAnnealingLR, whose rate rises again if there are more updates than that.
    share = CosineWeight(init=1.0, final=0.0, duration=max(updates, 1))
    others = len(optimizer.param_groups) - 1
    return LambdaLR(optimizer, [lambda update: share(update), *[lambda _update: 1.0] * others])


def _norm(tensors: Iterable[Tensor]) -> Tensor:
    return torch.nn.utils.get_total_norm(tensors)


def _dot(left: Iterable[Tensor], right: Iterable[Tensor]) -> Tensor:
    return torch.stack([(a * b).sum() for a, b in zip(left, right, strict=True)]).sum()
