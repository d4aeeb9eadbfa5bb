"""What one optimization step does: the order of updates and how the actor's gradients meet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.trainers import OptimizationStepper, Trainer

from losses import Objective
from pipeline.learn.gradients import ObjectiveGradients, Weights, hand_over
from pipeline.learn.optimizers import AdamStep, load_adam, make_adam, make_annealing, set_recordable
from pipeline.learn.update_guard import HEALTH, GuardedUpdate, Network, UpdateGuard
from pipeline.machine.compilation import compiled
from pipeline.machine.cuda_graphs import Update, recorded


@dataclass(frozen=True)
class UpdateSchedule:
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


@dataclass(frozen=True)
class StepParts:
    """What one step consists of besides the critics' update."""

    actor: bool
    """Whether actor and temperature are updated."""
    by_terms: bool
    """Whether the gradients of the actor's terms are taken apart."""
    target: bool
    """Whether the target critics move."""


class BCSACStepper(OptimizationStepper):
    """One step: critic, then actor and temperature, then target network.

    The actor's gradients, of the RL objective and of the imitation term (and of what other terms
    the loss has), are added with the weights ``lambda(n)`` of the loss (paper III-C, III-D), or
    with what the terms' rules make of these (:class:`~losses.GradientRatio`). What it logs follows
    from the terms: :attr:`metrics`.

    Args:
        loss: Terms and networks.
        actor_lr: Adam's rate for the actor; likewise ``critic_lr`` and ``temperature_lr``.
        schedule: How often each part runs.
        max_grad_norm: Clips the norm of the actor's and the critic's gradient; None leaves them.
        anneal_updates: Actor updates over which a cosine takes the actor's rate to zero; None
            keeps it constant.
        cuda_graphs: Whether to replay updates as CUDA graphs. Networks and batches are on a GPU
            then, and without ``loss.rl_on_demos`` the loss must know its ``main_rows``.
        compile_updates: Whether to compile the updates
            (:class:`~pipeline.machine.compilation.Compiled`); the loss must know its ``main_rows``
            likewise.
        guarded: Whether to stop where a loss or a parameter is not finite; off for measurements.
    """

    def __init__(  # noqa: PLR0913 - the settings of a run, flat
        self,
        loss: Objective,
        *,
        actor_lr: float,
        critic_lr: float,
        temperature_lr: float,
        schedule: UpdateSchedule | None = None,
        max_grad_norm: float | None = None,
        anneal_updates: int | None = None,
        cuda_graphs: bool = False,
        compile_updates: bool = False,
        guarded: bool = True,
    ) -> None:
        self.loss = loss
        self.guard = _guard(loss) if guarded else None
        self.schedule = schedule if schedule is not None else UpdateSchedule()
        self.max_grad_norm = max_grad_norm
        self.optimizers = {
            "critic": make_adam([(loss.critic.parameters(), critic_lr)]),
            # Together, because a step costs a small network more in calls than in arithmetic.
            "actor": make_adam(
                [(loss.actor.parameters(), actor_lr), ([loss.log_alpha], temperature_lr)]
            ),
        }
        self._adam = {name: AdamStep(optimizer) for name, optimizer in self.optimizers.items()}
        self.annealing = make_annealing(self.optimizers["actor"], anneal_updates)
        self.critic_updates = 0
        self.last: dict[str, Tensor] = {}
        self.metrics = loss.composition.metrics
        """Names of what every step's result holds; what a step does not compute keeps its value."""
        self._unknown = torch.full((), torch.nan, device=loss.log_alpha.device)
        self.weights = Weights(loss)
        self.gradients = ObjectiveGradients(loss, self.weights)
        # A target that moves at every update does so in its critics' loops, since the actor's
        # update does not look at it. One that moves now and then would need two compilations.
        self._target_with_critic = compile_updates and self.schedule.target_period == 1
        self._target = [*loss.target_critic.parameters(), *loss.target_critic.buffers()]
        self._learn_critic = compiled(self._critic_update, self._critic_state, compile_updates)
        actor = self._adam["actor"].state
        self._learn_actor = compiled(self._actor_update, actor, compile_updates)
        # Taken apart for measurements alone, one update in a hundred is not worth compiling.
        self._always_apart = bool(self.weights.rules)
        self._learn_actor_by_terms = compiled(
            partial(self._actor_update, by_terms=True),
            actor,
            compile_updates and self._always_apart,
        )
        self._cuda_graphs = cuda_graphs
        self._prepare = partial(set_recordable, recorded=cuda_graphs, compiled=compile_updates)
        for optimizer in self.optimizers.values():
            self._prepare(optimizer)
        self._updates: dict[StepParts, Update] = {}

    def step(self, _trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch; returns the detached scalars of :attr:`metrics` as one tensor.

        The trainer averages the entries of results with five operations each, which for a dozen
        scalars takes as long as the products of a small layer. :meth:`named` takes them apart.

        Raises:
            NonFiniteError: If a loss or a parameter is not finite; see ``UpdateGuard``.
        """
        self.weights.update()
        parts = self._parts_due()
        if parts not in self._updates:
            self._updates[parts] = recorded(partial(self._learn, parts), self._cuda_graphs)
        found = self._updates[parts](sub_batch)
        self.critic_updates += 1
        if self.guard is not None:
            health = found.pop(HEALTH)
            self.guard.watch(GuardedUpdate(self.critic_updates, health, sub_batch, found))
        self.last.update(found)
        if parts.actor:
            self.annealing.step()
            self.loss.advance()
        metrics = torch.stack([self.last.get(key, self._unknown) for key in self.metrics])
        return TensorDict({"metrics": metrics})

    def settle(self) -> None:
        """Waits until all updates so far are known to be finite.

        Raises:
            NonFiniteError: If one was not.
        """
        if self.guard is not None:
            self.guard.settle()

    def named(self, result: TensorDictBase) -> dict[str, Tensor]:
        """The scalars of a step's result by name, or of the average of several."""
        return dict(zip(self.metrics, result["metrics"].unbind(), strict=True))

    def log_metrics(self, _updates: int, average: TensorDictBase) -> dict[str, Tensor]:
        """Trainer hook ``post_optim_complete_log``: what it logs of its average of results."""
        return self.named(average)

    def _parts_due(self) -> StepParts:
        schedule = self.schedule
        updates = self.critic_updates + 1
        after_delay = updates - schedule.actor_delay
        actor = after_delay > 0 and after_delay % schedule.actor_period == 0
        diagnose = self.loss.updates % schedule.diagnostics_period == 0
        return StepParts(
            actor=actor,
            by_terms=actor and (diagnose or self._always_apart),
            target=updates % schedule.target_period == 0,
        )

    def _learn(self, parts: StepParts, batch: TensorDictBase) -> dict[str, Tensor]:
        found = self._learn_critic(batch)
        if parts.actor:
            more = (self._learn_actor_by_terms if parts.by_terms else self._learn_actor)(batch)
            if self.guard is not None:
                more[HEALTH] = more[HEALTH] + found[HEALTH]
            found |= more
        if parts.target and not self._target_with_critic:
            self.loss.update_target()
        return found

    def _critic_state(self) -> list[Tensor]:
        return [*self._adam["critic"].state(), *self._target]

    def _critic_update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        found, gradients = self.gradients.critic(batch)
        hand_over(self.gradients.critic_parameters, gradients)
        self._clip(self.gradients.critic_parameters)
        self._adam["critic"]()
        if self._target_with_critic:
            self.loss.update_target()
        return found | self._health(found, self.gradients.critic_parameters)

    def _actor_update(self, batch: TensorDictBase, *, by_terms: bool = False) -> dict[str, Tensor]:
        of = self.gradients
        found, gradients = (of.actor_by_terms if by_terms else of.actor)(batch)
        hand_over([*of.actor_parameters, *of.temperature], gradients)
        self._clip(of.actor_parameters)
        self._adam["actor"]()
        found |= self._health(found, [*of.actor_parameters, *of.temperature])
        return found | self.loss.after_step()

    def _health(
        self, found: dict[str, Tensor], parameters: Iterable[nn.Parameter]
    ) -> dict[str, Tensor]:
        if self.guard is None:
            return {}
        return {HEALTH: self.guard.health(found, parameters)}

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
        """Restores what :meth:`state_dict` gave, except for the rates: those stay its own."""
        saved = state["optimizers"]
        load_adam(self.optimizers["critic"], saved["critic"])
        load_adam(self.optimizers["actor"], saved["actor"], self.annealing, state["annealing"])
        for optimizer in self.optimizers.values():
            self._prepare(optimizer)
        self._updates.clear()  # recorded on the memory of the moments and rates before
        self.critic_updates = state["critic_updates"]
        self.last = {key: value.to(self._unknown.device) for key, value in state["last"].items()}


def _guard(loss: Objective) -> UpdateGuard:
    """Over the terms and networks of ``loss``."""
    terms = loss.composition
    critic, actor, temperature = (
        {term.name: term.metric for term in of_one if term is not None}
        for of_one in (terms.of_critic, terms.of_actor, [terms.temperature])
    )
    own = {"log_alpha": loss.log_alpha}
    return UpdateGuard([
        Network("critic", dict(loss.critic.named_parameters()), critic, "optim.critic_lr"),
        Network("actor", dict(loss.actor.named_parameters()), actor, "optim.actor_lr"),
        Network("temperature", own, temperature, "optim.temperature_lr"),
    ])  # fmt: skip
