"""Reinforcement learning with demonstrations: buffers, stepper, collector and hooks together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from torch import nn

from configs.schema import Config
from pipeline import components
from pipeline.buffers import make_buffer
from pipeline.checkpoint import CollectorState, make_checkpoint, resumes_midway
from pipeline.cloning import behaviour_cloned
from pipeline.components import Demonstrations
from pipeline.compute import hidden_dtype, replays_updates
from pipeline.diagnostics import DemonstrationProbe, TrainingState
from pipeline.exploration import PartlyGreedyPolicy
from pipeline.growth import demonstration_distribution, register_growth, require_growth
from pipeline.hooks import (
    ActorAverageHook,
    BacktrackHook,
    DemoUpdateHook,
    EpisodeHook,
    StoreHook,
)
from pipeline.mixture import DRAWS, Mixture
from pipeline.stepper import BCSACStepper, StepRhythm, log_metrics
from pipeline.threads import OneThreadCollector
from pipeline.time_use import TimeUse
from pipeline.trainer import Run, make_evaluation_hook, make_trainer

ROW_LIMIT = 1_000_000
"""The main buffer holds the whole run up to this many frames, or ``sampler.capacity``."""


def build_online(
    config: Config, run_dir: Path, demos: Demonstrations | None, time_use: TimeUse
) -> Run:
    """Reinforcement learning, with whatever help from D the configuration asks for."""
    require_growth(config)
    device, dtype = config.device, hidden_dtype(config)
    env = components.make_training_env(config)
    normalizer = components.make_normalizer(config.actor, demos)
    actor = components.make_policy(config.actor, env, normalizer, device, dtype)
    normalizer = components.make_normalizer(config.critic, demos)
    critic = components.make_critic(config.critic, env, normalizer, device, dtype)
    updates = components.actor_updates(config)
    rows = config.sampler.batch_size
    actions = env.action_spec.shape[-1]
    loss = components.make_loss(
        config.loss,
        actor,
        critic,
        actions,
        updates,
        main_rows=rows or None,  # of no rows, the mixture says what is wrong
        bc_emphasis=components.make_emphasis(config),
    )
    if config.pretrain:
        actor.load_state_dict(behaviour_cloned(config, demos, time_use).state_dict())

    to_rows = components.make_rows(config)
    main = make_buffer(_capacity(config), device)
    grown, distribution = demonstration_distribution(config, demos, to_rows, time_use)
    mixture = Mixture(
        main,
        distribution,
        main_rows=rows,
        demo_rows=round(config.sampler.demo_ratio * rows),
        draws=min(_updates_per_batch(config), DRAWS),
        device=device,
    )
    stepper = BCSACStepper(
        loss,
        actor_lr=config.optim.actor_lr,
        critic_lr=config.optim.critic_lr,
        temperature_lr=config.optim.temperature_lr,
        rhythm=StepRhythm(
            actor_period=config.optim.actor_period,
            target_period=config.optim.target_period,
            actor_delay=config.optim.actor_delay,
            diagnostics_period=config.optim.diagnostics_period,
        ),
        bc_gradient_ratio=config.loss.bc_gradient_ratio,
        max_grad_norm=config.optim.max_grad_norm,
        anneal_updates=updates if config.optim.anneal_actor else None,
        cuda_graphs=replays_updates(config),
        compile_updates=bool(config.compile_updates),
    )
    average = None
    decay = components.average_decay(config)
    if decay is not None:
        average = ActorAverageHook(actor, decay)
    policy = actor if average is None else average.average
    greedy = config.collector.greedy_envs
    collector = OneThreadCollector(
        env,
        PartlyGreedyPolicy(actor, greedy, config.env.num_envs) if greedy else actor,
        frames_per_batch=config.collector.frames_per_batch,
        total_frames=-1,  # the trainer counts, so that a resumed run can go on for longer
        init_random_frames=config.collector.random_frames,
        policy_device=device,
        env_device=device,
        storing_device=device,
        track_traj_ids=False,
        auto_register_policy_transforms=False,  # the policies here are memoryless
    )
    time_use.watch(env, "_step", "physics")
    time_use.watch(collector, "rollout", "collect")
    trainer = make_trainer(
        config,
        run_dir,
        make_checkpoint(policy, CollectorState(collector)),
        time_use,
        collector=collector,
        total_frames=config.collector.total_frames,
        optim_steps_per_batch=_updates_per_batch(config),
        loss_module=loss,
        optimization_stepper=stepper,
    )
    if average is not None:
        average.register(trainer)
    backtracking = _backtracking(config, [actor] if policy is actor else [actor, policy])
    for hook in backtracking:
        hook.register(trainer)
    harvests = register_growth(config, grown, to_rows, trainer)
    episodes = EpisodeHook(
        *harvests, *backtracking, resumes_midway=resumes_midway(env), device=device
    )
    episodes.register(trainer)
    store = StoreHook(main, to_rows)
    time_use.watch(store, "store", "store")
    store.register(trainer)
    trainer.register_op("process_optim_batch", time_use.timed(mixture, "sample"))
    trainer.register_op("post_optim_complete_log", log_metrics)
    if config.sampler.demo_update_period:
        demo_batches = Mixture(None, distribution, main_rows=0, demo_rows=rows, device=device)
        DemoUpdateHook(stepper, demo_batches, config.sampler.demo_update_period).register(trainer)
    diagnostics: list[Callable[[], Mapping[str, float]]] = [
        TrainingState(stepper),
        episodes.averages,
        *[hook.counted for hook in backtracking],
    ]
    if demos is not None:
        diagnostics.append(DemonstrationProbe(loss, demos.rows, demos.held_out))
    make_evaluation_hook(config, policy, run_dir, time_use, *diagnostics).register(trainer)
    return Run(config, run_dir, trainer, policy, time_use)


def _capacity(config: Config) -> int:
    capacity = config.sampler.capacity
    if capacity is None:
        return min(config.collector.total_frames, ROW_LIMIT)
    if capacity < config.collector.frames_per_batch:
        raise ValueError(
            f"sampler.capacity ({capacity}) must hold at least one collected batch: "
            f"collector.frames_per_batch is {config.collector.frames_per_batch}."
        )
    return capacity


def _backtracking(config: Config, modules: list[nn.Module]) -> list[BacktrackHook]:
    """The hook over ``modules``, or none."""
    backtrack = config.backtrack
    if backtrack.level is None:
        return []
    if config.env.name != "door":
        raise ValueError(
            f"backtrack.level={backtrack.level} counts doors that open, and env.name is "
            f"{config.env.name}: set backtrack.level=null."
        )
    hook = BacktrackHook(modules, backtrack.level, window=backtrack.window, memory=backtrack.memory)
    return [hook]


def _updates_per_batch(config: Config) -> int:
    updates = config.optim.updates_per_frame * config.collector.frames_per_batch
    if updates < 1 or abs(updates - round(updates)) > 1e-9:
        raise ValueError(
            f"optim.updates_per_frame ({config.optim.updates_per_frame}) times "
            f"collector.frames_per_batch ({config.collector.frames_per_batch}) must be a whole "
            f"number of at least 1, got {updates}."
        )
    return round(updates)
