"""What learns in a run: actor, critics, the loss over them, and the step that trains them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from envs import Task
from losses import BCSACLoss, Proposal
from pipeline.act.exploration import PartlyGreedyPolicy
from pipeline.act.policy_wrappers import acting_policy
from pipeline.cloning import behaviour_cloned
from pipeline.compute import hidden_dtype, replays_updates
from pipeline.conversion import make_emphasis
from pipeline.data.demonstrations import Demonstrations, make_normalizer
from pipeline.files.time_use import TimeUse
from pipeline.hooks import ActorAverageHook
from pipeline.learn.critics import make_critic
from pipeline.learn.loss import make_loss
from pipeline.learn.networks import make_policy
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from pipeline.recipe import Recipe
from pipeline.updates import actor_updates, main_updates


@dataclass(frozen=True)
class Learner:
    """The networks of a run and how they are trained.

    Attributes:
        recipe: of the run.
        actor: learns, and explores.
        loss: with the critics.
        stepper: one optimization step.
        average: keeps an average of the actor's weights; None for none.
        proposal: what a BC model proposes beside the policy where one acts; None for nothing.
    """

    recipe: Recipe
    actor: ProbabilisticActor
    loss: BCSACLoss
    stepper: BCSACStepper
    average: ActorAverageHook | None
    proposal: Proposal | None

    @property
    def judged(self) -> TensorDictModuleBase:
        """The actor whose weights are evaluated and kept: the average, where there is one."""
        return self.actor if self.average is None else self.average.average

    @property
    def actors(self) -> list[nn.Module]:
        """All that a return to earlier weights takes back."""
        return [self.actor] if self.average is None else [self.actor, self.judged]

    def policy(self) -> TensorDictModuleBase:
        """What is evaluated and kept."""
        return self._acting(self.judged)

    def explorer(self) -> TensorDictModuleBase:
        """What collects experience."""
        greedy = self.recipe.collector.greedy_envs
        if not greedy:
            return self._acting(self.actor)
        return self._acting(PartlyGreedyPolicy(self.actor, greedy, self.recipe.env.num_envs))

    def _acting(self, core: TensorDictModuleBase) -> TensorDictModuleBase:
        return acting_policy(
            core,
            chunk=self.recipe.actor.chunk,
            proposal=self.proposal,
            critic=self.loss.target_critic,
        )


def make_learner(
    recipe: Recipe,
    task: Task,
    env: EnvBase,
    demos: Demonstrations | None,
    main_rows: int,
    time_use: TimeUse,
) -> Learner:
    """The learner for the spaces of ``env``; with ``pretrain`` it begins as the BC model.

    Its batches have ``main_rows`` rows before those that are demonstrations.
    """
    dtype, chunk = hidden_dtype(recipe), recipe.actor.chunk
    normalizer = make_normalizer(recipe.actor, demos)
    actor = make_policy(recipe.actor, env, normalizer, recipe.device, dtype)
    normalizer = make_normalizer(recipe.critic, demos)
    critic = make_critic(recipe.critic, env, normalizer, recipe.device, dtype, chunk)
    cloned = partial(behaviour_cloned, recipe, task, demos, time_use)
    proposal = recipe.proposal.of(cloned()) if recipe.proposal.used else None
    loss = make_loss(
        recipe.loss,
        actor,
        critic,
        chunk * env.action_spec.shape[-1],
        actor_updates(recipe),
        main_rows=main_rows,
        bc_emphasis=make_emphasis(recipe),
        proposal=proposal if recipe.proposal.bootstrap else None,
    )
    if recipe.pretrain:
        actor.load_state_dict(cloned().state_dict())
    decay = average_decay(recipe)
    return Learner(
        recipe,
        actor,
        loss,
        make_stepper(recipe, loss),
        None if decay is None else ActorAverageHook(actor, decay),
        proposal if recipe.proposal.acting else None,
    )


def make_stepper(recipe: Recipe, loss: BCSACLoss) -> BCSACStepper:
    """What one optimization step of the run does."""
    optim = recipe.optim
    return BCSACStepper(
        loss,
        actor_lr=optim.actor_lr,
        critic_lr=optim.critic_lr,
        temperature_lr=optim.temperature_lr,
        schedule=UpdateSchedule(
            actor_period=optim.actor_period,
            target_period=optim.target_period,
            actor_delay=optim.actor_delay,
            diagnostics_period=optim.diagnostics_period,
        ),
        max_grad_norm=optim.max_grad_norm,
        anneal_updates=actor_updates(recipe) if optim.anneal_actor else None,
        cuda_graphs=replays_updates(recipe),
        compile_updates=bool(recipe.compile_updates),
    )


def average_decay(recipe: Recipe) -> float | None:
    """What one update keeps of the average of the actor's weights; None for no average.

    An average as long as a fixed share of the run serves short runs and long ones alike: it reaches
    as far back as the policy has changed little.

    Raises:
        ValueError: If it is given in two ways, or its share is out of range.
    """
    decay, share = recipe.optim.actor_average, recipe.optim.actor_average_share
    if share is None:
        return decay
    if decay is not None:
        raise ValueError(
            f"optim.actor_average ({decay}) and optim.actor_average_share ({share}) both say how "
            "long the average is: set one of them to null."
        )
    if not 0.0 < share < 1.0:
        raise ValueError(f"optim.actor_average_share must be in (0, 1) or null, got {share}.")
    # The average moves with the trainer's own updates, not with DA-SAC's extra ones.
    window = round(share * main_updates(recipe))
    return 1.0 - 1.0 / window if window > 1 else None
