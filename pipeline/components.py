"""Parts of a run, each made from the values of the configuration that it needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from envs import Task
from envs.disturbed import disturbed
from envs.task import PROGRESS, SUCCESS, States, has_column
from losses import BCSACLoss, GradientRatio, Proposal
from pipeline.act.evaluation import Evaluator
from pipeline.compute import replays_updates
from pipeline.data.curriculum import ReverseCurriculum
from pipeline.data.demonstrations import Demonstrations
from pipeline.data.emphasis import ProgressEmphasis
from pipeline.data.progress_bonus import ProgressBonus
from pipeline.data.rows import TransitionRows
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import ActorSettings, CriticSettings, ObservationNormalizer, make_actor
from pipeline.learn.objective import LossSettings
from pipeline.learn.own_terms import own_terms
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from pipeline.recipe import Recipe
from pipeline.updates import actor_updates


def make_episode_rows(recipe: Recipe) -> TransitionRows:
    """The conversion of whole episodes, which tell what terms need of their ends.

    Raises:
        ValueError: As :func:`make_rows`.
    """
    return make_rows(recipe, to_end=recipe.loss.self_imitation.weight > 0.0)


def make_rows(recipe: Recipe, *, to_end: bool = False) -> TransitionRows:
    """The conversion from trajectories to rows that all buffers share.

    Args:
        recipe: Of the run.
        to_end: Whether rows hold the way to the end of their episode.

    Raises:
        ValueError: If ``loss.progress_bonus`` is negative, or rows do not look as many steps ahead
            as there are actions in a chunk.
    """
    loss, chunk = recipe.loss, recipe.actor.chunk
    if chunk > 1 and loss.n_step != chunk:
        raise ValueError(
            f"actor.chunk={chunk} gives so many actions at once, whose rewards a row adds up: set "
            f"loss.n_step={chunk} too, it is {loss.n_step}."
        )
    bonus = ProgressBonus(loss.progress_bonus, loss.progress_bonus_cap)
    return TransitionRows(
        loss.gamma,
        loss.n_step,
        loss.reward_factor,
        bonus if loss.progress_bonus else None,
        columns=() if make_emphasis(recipe) is None else (PROGRESS,),
        to_end=to_end,
        chunk=chunk,
    )


def make_emphasis(recipe: Recipe) -> ProgressEmphasis | None:
    """What weighs the demonstrated steps in the actor's objective; None if all count alike.

    Raises:
        ValueError: If a factor is out of range.
    """
    emphasis = recipe.loss.bc_emphasis
    if emphasis.before == emphasis.beyond == 1.0:
        return None
    return ProgressEmphasis(emphasis.before, emphasis.beyond, emphasis.progress)


def make_training_env(recipe: Recipe, task: Task) -> EnvBase:
    """The batched environment of the collector, randomised where the recipe says so.

    Raises:
        ValueError: If the configuration asks for the progress or the success of a task that does
            not tell it.
    """
    randomised = disturbed(task, recipe.task.randomise.disturbance)
    env = randomised.make_env(
        recipe.env_options(
            num_envs=recipe.env.num_envs,
            seed=recipe.seed,
            success_steps=recipe.env.success_steps,
        )
    )
    emphasis = recipe.loss.bc_emphasis
    _require_column(env, PROGRESS, task, {
        f"loss.progress_bonus={recipe.loss.progress_bonus}": recipe.loss.progress_bonus != 0.0,
        f"loss.bc_emphasis.beyond={emphasis.beyond}": emphasis.before != emphasis.beyond,
    })  # fmt: skip
    return env


def make_curriculum(
    recipe: Recipe, task: Task, env: EnvBase, demos: Demonstrations | None
) -> ReverseCurriculum | None:
    """Where training episodes of ``env`` begin; None where they begin as the task's own do.

    Raises:
        MissingCapabilityError: If the task cannot be put into states of demonstrations.
        ValueError: If it tells no success.
    """
    curriculum = recipe.curriculum
    if not curriculum.reverse:
        return None
    states: States = task.require("states", key := "curriculum.reverse=true")
    _require_column(env, SUCCESS, task, {key: True})
    episodes = () if demos is None else demos.episodes
    found = states(episodes, num_threads=recipe.env.num_threads)
    return ReverseCurriculum(found, curriculum.stride, curriculum.successes)


def _require_column(env: EnvBase, column: str, task: Task, users: Mapping[str, bool]) -> None:
    asked = [key for key, used in users.items() if used]
    if asked and not has_column(env, column):
        raise ValueError(
            f"{asked[0]} needs a task that tells its {column}, and task {task.name} does not: "
            f"leave it out, or tell it (task.{column}=...)."
        )


def make_policy(
    actor: ActorSettings,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
) -> ProbabilisticActor:
    """The actor for the spaces of ``env``."""
    return make_actor(
        env.observation_spec["observation"].shape[-1],
        actor.chunk * env.action_spec.shape[-1],
        actor.hidden,
        log_std_min=actor.log_std_min,
        log_std_max=actor.log_std_max,
        layer_norm=actor.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)


def make_critic(
    critic: CriticSettings,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
    chunk: int = 1,
) -> BatchedCritics:
    """The critic ensemble for the spaces of ``env``, of so many actions at once."""
    return BatchedCritics(
        env.observation_spec["observation"].shape[-1],
        chunk * env.action_spec.shape[-1],
        critic.hidden,
        critic.num_critics,
        layer_norm=critic.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)


def make_loss(
    loss: LossSettings,
    actor: ProbabilisticActor,
    critic: BatchedCritics,
    action_size: int,
    updates: int,
    main_rows: int | None = None,
    bc_emphasis: ProgressEmphasis | None = None,
    proposal: Proposal | None = None,
) -> BCSACLoss:
    """BCSACLoss with the configured terms.

    Args:
        loss: Its configuration.
        actor: Policy.
        critic: Ensemble.
        action_size: Dimensions of an action.
        updates: Of the actor in the whole run, over which a weight without ``duration`` moves.
        main_rows: Of each batch, before its demonstrations.
        bc_emphasis: Of the demonstrated steps in the actor's objective.
        proposal: Of another policy in the critics' targets.
    """
    ratio = loss.bc_gradient_ratio
    return BCSACLoss(
        actor,
        critic,
        gamma=loss.gamma,
        init_temperature=loss.init_temperature,
        target_entropy=loss.entropy_target(action_size),
        learn_temperature=loss.learn_temperature,
        bc_weight=loss.bc_weight.schedule(updates),
        bc_rule=None if ratio is None else GradientRatio(ratio),
        imitation=loss.imitation_error,
        action_margin=loss.action_margin,
        target_subset=loss.target_subset,
        actor_value=loss.actor_value,
        target_action=loss.target_action,
        entropy_in_target=loss.entropy_in_target,
        rl_on_demos=loss.rl_on_demos,
        main_rows=main_rows,
        bc_emphasis=bc_emphasis,
        q_filter=loss.q_filter,
        tau=loss.tau,
        proposal=proposal,
        further=[*loss.self_imitation.terms(loss), *own_terms(loss.own_terms, updates)],
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


def make_evaluator(
    recipe: Recipe, task: Task, *, episodes: int, keep_env: bool = False, **env_options: Any
) -> Evaluator:
    """The evaluation of this run's policy, in environments with these options besides its own."""
    return Evaluator(
        task=task,
        episodes=episodes,
        seed=recipe.evaluation.seed,
        batch=recipe.evaluation.batch,
        noise_scale=recipe.evaluation.noise_scale,
        exploration=recipe.evaluation.exploration,
        env_options=recipe.env_options(**env_options),
        keep_env=keep_env,
    )


def make_normalizer(
    part: ActorSettings | CriticSettings, demos: Demonstrations | None
) -> ObservationNormalizer | None:
    """The standardisation that a network asks for, from the statistics of the demonstrations.

    Raises:
        ValueError: If one is asked for but there are no demonstrations.
    """
    if not part.normalise_observations:
        return None
    if demos is None:
        raise ValueError(
            "normalise_observations=true needs demonstrations, whose statistics it uses, but this "
            "composition has none: set actor.normalise_observations=false and "
            "critic.normalise_observations=false."
        )
    return demos.normalizer()
