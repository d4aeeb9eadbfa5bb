"""Parts of a run, each made from the values of the configuration that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from omegaconf import OmegaConf
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from configs.schema import ActorConfig, Config, CriticConfig, DemosConfig, LossConfig
from envs import make_env
from envs.demonstrations import (
    DemonstrationSet,
    MultiplyConfig,
    load_demonstrations,
    to_tensordict,
)
from losses import BCSACLoss, make_schedule
from pipeline.angle_bonus import AngleBonus
from pipeline.critics import BatchedCritics
from pipeline.emphasis import OpeningEmphasis
from pipeline.evaluation import Evaluator
from pipeline.networks import ObservationNormalizer, make_actor
from pipeline.rows import TransitionRows

LASTING = ("linear", "cosine")
"""Schedules that take the whole run unless they have a duration of their own."""


@dataclass(frozen=True)
class Demonstrations:
    """The core of D, ready for the buffers."""

    rows: TensorDictBase
    """Transitions [R] of the episodes to train on."""
    held_out: TensorDictBase | None
    """Transitions of the ``demos.held_out`` last episodes, which only diagnostics see."""
    content_hash: str
    """Of the episodes, for caches and for the record."""
    source: str

    def normalizer(self) -> ObservationNormalizer:
        """Standardisation by the mean and standard deviation of the demonstrated observations."""
        observation = self.rows["observation"]
        return ObservationNormalizer(observation.mean(0), observation.std(0))


def make_demonstrations(
    demos: DemosConfig, to_rows: TransitionRows, *, cache_dir: Path, num_threads: int | None
) -> Demonstrations:
    """Loads, checks, re-simulates and multiplies the demonstrations as configured.

    Raises:
        DemonstrationError: If they are not usable.
        ValueError: If as many or more are to be held out as there are.
    """
    multiply = None
    if demos.multiply.enabled:
        multiply = MultiplyConfig(
            target_episodes=demos.multiply.target_episodes,
            max_attempts=demos.multiply.max_attempts,
            seed=demos.multiply.seed,
            noise_scale=demos.multiply.noise_scale,
            speed_low=demos.multiply.speed_low,
            speed_high=demos.multiply.speed_high,
            min_angle=demos.multiply.min_angle,
        )
    loaded: DemonstrationSet = load_demonstrations(
        demos.source,
        resimulate=demos.resimulate,
        multiply=multiply,
        num_threads=num_threads,
        cache_dir=cache_dir,
        limit=demos.limit,
        keep_best=demos.keep_best,
        end_angle=demos.end_angle,
    )
    count = len(loaded.episodes) - demos.held_out
    if demos.held_out < 0 or count < 1:
        raise ValueError(
            f"demos.held_out must be at least 0 and leave demonstrations to train on, got "
            f"{demos.held_out} of {len(loaded.episodes)} episodes."
        )
    rows = [to_rows(episode) for episode in to_tensordict(loaded.episodes)]
    return Demonstrations(
        rows=torch.cat(rows[:count]),
        held_out=torch.cat(rows[count:]) if demos.held_out else None,
        content_hash=loaded.content_hash,
        source=loaded.source,
    )


def make_rows(config: Config) -> TransitionRows:
    """The conversion from trajectories to rows that all buffers share.

    Raises:
        ValueError: If ``loss.angle_bonus`` is negative, or set for a task that has no door.
    """
    loss = config.loss
    if loss.angle_bonus and config.env.name != "door":
        raise ValueError(
            f"loss.angle_bonus={loss.angle_bonus} pays for a door's hinge angle, which "
            f"env.name={config.env.name} does not have: set it to 0."
        )
    bonus = AngleBonus(loss.angle_bonus) if loss.angle_bonus else None
    return TransitionRows(loss.gamma, loss.n_step, loss.reward_scale, bonus)


def make_emphasis(config: Config) -> OpeningEmphasis | None:
    """What weighs the demonstrated steps in the actor's objective; None if all count alike.

    Raises:
        ValueError: If a factor is out of range, or set for a task that has no door.
    """
    emphasis = config.loss.bc_emphasis
    if emphasis.closed == emphasis.open == 1.0:
        return None
    if config.env.name != "door":
        raise ValueError(
            f"loss.bc_emphasis (closed={emphasis.closed}, open={emphasis.open}) goes by a door's "
            f"hinge angle, which env.name={config.env.name} does not have: set both to 1."
        )
    return OpeningEmphasis(emphasis.closed, emphasis.open, emphasis.angle)


def make_training_env(config: Config) -> EnvBase:
    """The batched environment of the collector."""
    return make_env(
        config.env.name,
        num_envs=config.env.num_envs,
        seed=config.seed,
        device=config.device,
        num_threads=config.env.num_threads,
        horizon=config.env.horizon,
        open_steps=config.env.open_steps,
    )


def make_policy(
    actor: ActorConfig,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
) -> ProbabilisticActor:
    """The actor for the spaces of ``env``."""
    return make_actor(
        env.observation_spec["observation"].shape[-1],
        env.action_spec.shape[-1],
        actor.hidden,
        log_std_min=actor.log_std_min,
        log_std_max=actor.log_std_max,
        layer_norm=actor.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)


def make_critic(
    critic: CriticConfig,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
) -> BatchedCritics:
    """The critic ensemble for the spaces of ``env``."""
    return BatchedCritics(
        env.observation_spec["observation"].shape[-1],
        env.action_spec.shape[-1],
        critic.hidden,
        critic.num_critics,
        layer_norm=critic.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)


def actor_updates(config: Config) -> int:
    """Actor updates of the whole run: what annealing and schedules that last as long count."""
    if config.offline:
        return config.bc.updates
    learning_frames = config.collector.total_frames - config.collector.random_frames
    critic_updates = round(config.optim.updates_per_frame * learning_frames)
    if config.sampler.demo_update_period:
        critic_updates += critic_updates // config.sampler.demo_update_period
    return max(critic_updates - config.optim.actor_delay, 0) // config.optim.actor_period


def average_decay(config: Config) -> float | None:
    """What one update keeps of the average of the actor's weights; None for no average.

    An average as long as a fixed share of the run serves short runs and long ones alike: it reaches
    as far back as the policy has changed little.

    Raises:
        ValueError: If it is given in two ways, or its share is out of range.
    """
    decay, share = config.optim.actor_average, config.optim.actor_average_share
    if share is None:
        return decay
    if decay is not None:
        raise ValueError(
            f"optim.actor_average ({decay}) and optim.actor_average_share ({share}) both say how "
            "long the average is: set one of them to null."
        )
    if not 0.0 < share < 1.0:
        raise ValueError(f"optim.actor_average_share must be in (0, 1) or null, got {share}.")
    updates = config.optim.updates_per_frame * config.collector.total_frames
    window = round(share * updates)
    return 1.0 - 1.0 / window if window > 1 else None


def make_loss(
    loss: LossConfig,
    actor: ProbabilisticActor,
    critic: BatchedCritics,
    action_size: int,
    updates: int,
    main_rows: int | None = None,
    bc_emphasis: OpeningEmphasis | None = None,
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
    """
    # A dataclass when composed in Python, a DictConfig when composed by Hydra.
    weight = OmegaConf.to_container(OmegaConf.create(cast(Any, loss.bc_weight)), resolve=True)
    schedule = {k: v for k, v in cast(dict[str, Any], weight).items() if v is not None}
    if schedule["kind"] in LASTING:
        schedule.setdefault("duration", max(updates, 1))
    return BCSACLoss(
        actor,
        critic,
        gamma=loss.gamma,
        init_temperature=loss.init_temperature,
        target_entropy=-float(action_size) if loss.target_entropy is None else loss.target_entropy,
        learn_temperature=loss.learn_temperature,
        bc_weight=make_schedule(**schedule),
        imitation=loss.imitation,  # type: ignore[arg-type]  # OmegaConf has no Literal
        action_margin=loss.action_margin,
        target_subset=loss.target_subset,
        actor_value=loss.actor_value,  # type: ignore[arg-type]  # OmegaConf has no Literal
        target_action=loss.target_action,  # type: ignore[arg-type]  # OmegaConf has no Literal
        entropy_in_target=loss.entropy_in_target,
        rl_on_demos=loss.rl_on_demos,
        main_rows=main_rows,
        bc_emphasis=bc_emphasis,
        q_filter=loss.q_filter,
        tau=loss.tau,
    )


def make_evaluator(config: Config, *, episodes: int) -> Evaluator:
    """The evaluation of this run's policy."""
    return Evaluator(
        env_name=config.env.name,
        episodes=episodes,
        seed=config.evaluation.seed,
        batch=config.evaluation.batch,
        noise_scale=config.evaluation.noise_scale,
        exploration=config.evaluation.exploration,  # type: ignore[arg-type]  # as above
        horizon=config.env.horizon,
        num_threads=config.env.num_threads,
        device=config.device,
    )


def make_normalizer(
    part: ActorConfig | CriticConfig, demos: Demonstrations | None
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
