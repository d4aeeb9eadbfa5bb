"""Composition root: from a configuration to a run that can be trained.

The only module that knows all the others.  It decides nothing about the mathematics; it hands each
part the values and neighbours it needs.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from filelock import FileLock
from omegaconf import OmegaConf
from torchrl.checkpoint import Checkpoint
from torchrl.collectors import Collector
from torchrl.modules import ProbabilisticActor
from torchrl.trainers import Trainer

from configs.schema import Config
from pipeline import components
from pipeline.buffers import (
    DemonstrationDistribution,
    GrownDemonstrations,
    make_buffer,
    make_core_buffer,
)
from pipeline.checkpoint import (
    CollectorState,
    latest_checkpoint,
    load_component,
    load_trainer,
    make_checkpoint,
    make_rotation,
)
from pipeline.components import Demonstrations
from pipeline.grow import admit_rollouts
from pipeline.harvest import AdmissionRule, Harvest
from pipeline.hooks import DemoUpdateHook, EpisodeHook, EvaluationHook, GrownHook, StoreHook
from pipeline.loggers import make_loggers
from pipeline.mixture import Mixture
from pipeline.offline import OfflineStream
from pipeline.run_dir import LEARNING_CURVE, create_run_dir
from pipeline.stepper import BCSACStepper, ImitationStepper, StepRhythm

OFFLINE_UPDATES_PER_BATCH = 100
ROW_LIMIT = 1_000_000


@dataclass(frozen=True)
class Run:
    """A composed run."""

    config: Config
    run_dir: Path
    trainer: Trainer
    actor: ProbabilisticActor

    def train(self) -> None:
        """Trains to the end; the newest checkpoint and the learning curve are in ``run_dir``."""
        # The trainer looks at its total only after a batch: a complete run would grow by one.
        if self.trainer.collected_frames < self.trainer.total_frames:
            self.trainer.train()


def build_run(config: Config, *, resume: bool = False) -> Run:
    """Composes the run that ``config`` describes, in a new run directory or an existing one.

    Args:
        config: Resolved configuration.
        resume: Continue from the newest checkpoint in ``config.run_dir``.

    Raises:
        RunDirectoryError: If the directory exists (new run) or cannot be written.
        DemonstrationError: If the demonstrations are not usable.
        ValueError: If values of the configuration contradict each other.
    """
    run_dir = Path(config.run_dir)
    checkpoint = latest_checkpoint(run_dir) if resume else None
    if config.torch_threads is not None:
        torch.set_num_threads(config.torch_threads)
    demos = _demonstrations(config)
    if not resume:
        create_run_dir(run_dir, config)
    seed_everything(config.seed)
    build = build_offline if config.offline else build_online
    run = build(config, run_dir, demos)
    if checkpoint is not None:
        load_trainer(checkpoint, run.trainer)
    return run


def build_offline(config: Config, run_dir: Path, demos: Demonstrations | None) -> Run:
    """Behaviour cloning (paper, section III-B): updates on D alone."""
    if demos is None:
        raise ValueError("offline=true trains on demonstrations alone: set demos.source.")
    env = components.make_training_env(config)
    normalizer = components.make_normalizer(config.actor, demos)
    actor = components.make_policy(config.actor, env, normalizer, config.device)
    critic = components.make_critic(config.critic, env, None, config.device)
    loss = components.make_loss(config.loss, actor, critic, env.action_spec.shape[-1])
    env.close()
    core = DemonstrationDistribution(make_core_buffer(demos.rows, config.device))
    mixture = Mixture(None, core, main_rows=0, demo_rows=config.bc.batch_size, device=config.device)
    collector = OfflineStream(OFFLINE_UPDATES_PER_BATCH)
    trainer = _trainer(
        config,
        run_dir,
        make_checkpoint(actor, collector),
        collector=collector,
        total_frames=config.bc.updates,
        optim_steps_per_batch=OFFLINE_UPDATES_PER_BATCH,
        loss_module=loss,
        optimization_stepper=ImitationStepper(
            loss,
            actor_lr=config.bc.lr,
            anneal_updates=config.bc.updates if config.bc.anneal else None,
        ),
    )
    trainer.register_op("process_optim_batch", mixture)
    _evaluation_hook(config, actor, run_dir).register(trainer)
    return Run(config, run_dir, trainer, actor)


def build_online(config: Config, run_dir: Path, demos: Demonstrations | None) -> Run:
    """Reinforcement learning, with whatever help from D the configuration asks for."""
    device = config.device
    env = components.make_training_env(config)
    normalizer = components.make_normalizer(config.actor, demos)
    actor = components.make_policy(config.actor, env, normalizer, device)
    normalizer = components.make_normalizer(config.critic, demos)
    critic = components.make_critic(config.critic, env, normalizer, device)
    loss = components.make_loss(config.loss, actor, critic, env.action_spec.shape[-1])
    if config.pretrain:
        actor.load_state_dict(behaviour_cloned(config, demos).state_dict())

    to_rows = components.make_rows(config.loss)
    main = make_buffer(min(config.collector.total_frames, ROW_LIMIT), device)
    grown, distribution = _demonstration_distribution(config, demos, to_rows)
    rows = config.sampler.batch_size
    mixture = Mixture(
        main,
        distribution,
        main_rows=rows,
        demo_rows=round(config.sampler.demo_ratio * rows),
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
        anneal_updates=_actor_updates(config) if config.optim.anneal_actor else None,
    )
    collector = Collector(
        env,
        actor,
        frames_per_batch=config.collector.frames_per_batch,
        total_frames=-1,  # the trainer counts, so that a resumed run can go on for longer
        init_random_frames=config.collector.random_frames,
        policy_device=device,
        env_device=device,
        storing_device=device,
        track_traj_ids=False,
        auto_register_policy_transforms=False,  # the policies here are memoryless
    )
    trainer = _trainer(
        config,
        run_dir,
        make_checkpoint(actor, CollectorState(collector)),
        collector=collector,
        total_frames=config.collector.total_frames,
        optim_steps_per_batch=_updates_per_batch(config),
        loss_module=loss,
        optimization_stepper=stepper,
    )
    harvest = None
    if grown is not None:
        GrownHook(grown).register(trainer)
        if config.growth.self_imitation:
            harvest = Harvest(grown, _admission(config), to_rows, source="policy")
    EpisodeHook(on_episode=harvest).register(trainer)
    StoreHook(main, to_rows).register(trainer)
    trainer.register_op("process_optim_batch", mixture)
    if config.sampler.demo_update_period:
        demo_batches = Mixture(None, distribution, main_rows=0, demo_rows=rows, device=device)
        DemoUpdateHook(stepper, demo_batches, config.sampler.demo_update_period).register(trainer)
    _evaluation_hook(config, actor, run_dir).register(trainer)
    return Run(config, run_dir, trainer, actor)


def behaviour_cloned(config: Config, demos: Demonstrations | None) -> ProbabilisticActor:
    """The BC model of this configuration: trained once by the offline pipeline, then cached.

    It serves as the start of the actor (``pretrain``) and as the demonstrator of ILD (paper,
    section III-E.1: "the same BC model trained for comparison").

    Raises:
        ValueError: If there are no demonstrations.
    """
    if demos is None:
        raise ValueError("A BC model needs demonstrations: set demos.source.")
    bc_config: Config = OmegaConf.merge(  # type: ignore[assignment]  # typed loosely by OmegaConf
        config,
        {
            "offline": True,
            "pretrain": False,
            "growth": {"self_imitation": False, "bc_model": False},
            "critic": {"hidden": [8], "num_critics": 1},  # not trained offline
        },
    )
    identity = [demos.content_hash, config.env.name, config.seed, config.device]
    identity += [OmegaConf.to_container(part) for part in (config.actor, config.bc)]
    identity += [config.loss.imitation, config.loss.action_margin]
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:16]
    run_dir = Path(config.cache_dir) / f"bc-{digest}"
    complete = run_dir / "complete"
    bc_config.run_dir = str(run_dir)
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    rng = torch.random.get_rng_state()
    # Runs that start together (a sweep over variants) want the same model: one trains it.
    with FileLock(f"{run_dir}.lock"):
        if not run_dir.exists():
            create_run_dir(run_dir, bc_config)
        seed_everything(config.seed)
        run = build_offline(bc_config, run_dir, demos)
        if complete.exists():
            load_component(latest_checkpoint(run_dir), "policy", run.actor)
        else:
            checkpoint = make_rotation(run_dir).latest()
            if checkpoint is not None:
                load_trainer(checkpoint, run.trainer)
            run.train()
            complete.touch()
    torch.random.set_rng_state(rng)
    return run.actor


def seed_everything(seed: int) -> None:
    """Seeds torch and numpy; environments are seeded where they are built."""
    torch.manual_seed(seed)
    np.random.seed(seed)


def _demonstrations(config: Config) -> Demonstrations | None:
    needed = (
        config.offline
        or config.pretrain
        or config.sampler.demo_ratio > 0
        or config.sampler.demo_update_period > 0
        or config.growth.bc_model
        or config.actor.normalise_observations
        or config.critic.normalise_observations
    )
    if not needed:
        return None
    return components.make_demonstrations(
        config.demos,
        components.make_rows(config.loss),
        cache_dir=Path(config.cache_dir),
        num_threads=config.env.num_threads,
    )


def _demonstration_distribution(
    config: Config, demos: Demonstrations | None, to_rows: components.TransitionRows
) -> tuple[GrownDemonstrations | None, DemonstrationDistribution | None]:
    if demos is None:
        return None, None
    core = make_core_buffer(demos.rows, config.device)
    growth = config.growth
    if not growth.self_imitation and not growth.bc_model:
        return None, DemonstrationDistribution(core)
    grown = GrownDemonstrations(growth.capacity, config.device)
    if growth.bc_model:
        harvest = Harvest(grown, _admission(config), to_rows, source="bc_model")
        admit_rollouts(
            behaviour_cloned(config, demos),
            harvest,
            env_name=config.env.name,
            episodes=growth.bc_model_episodes,
            seed=config.seed,
            horizon=config.env.horizon,
            num_threads=config.env.num_threads,
            device=config.device,
        )
    return grown, DemonstrationDistribution(core, grown)


def _admission(config: Config) -> AdmissionRule:
    return AdmissionRule(config.growth.admission.min_angle, config.growth.admission.min_return)


def _updates_per_batch(config: Config) -> int:
    updates = config.optim.updates_per_frame * config.collector.frames_per_batch
    if updates < 1 or abs(updates - round(updates)) > 1e-9:
        raise ValueError(
            f"optim.updates_per_frame ({config.optim.updates_per_frame}) times "
            f"collector.frames_per_batch ({config.collector.frames_per_batch}) must be a whole "
            f"number of at least 1, got {updates}."
        )
    return round(updates)


def _actor_updates(config: Config) -> int:
    learning_frames = config.collector.total_frames - config.collector.random_frames
    critic_updates = round(config.optim.updates_per_frame * learning_frames)
    if config.sampler.demo_update_period:
        critic_updates += critic_updates // config.sampler.demo_update_period
    return max(critic_updates - config.optim.actor_delay, 0) // config.optim.actor_period


def _evaluation_hook(config: Config, actor: ProbabilisticActor, run_dir: Path) -> EvaluationHook:
    return EvaluationHook(
        components.make_evaluator(config, episodes=config.evaluation.interval_episodes),
        actor,
        config.evaluation.interval,
        run_dir / LEARNING_CURVE,
    )


def _trainer(config: Config, run_dir: Path, checkpoint: Checkpoint, **parts: object) -> Trainer:
    """TorchRL's trainer with this project's checkpointing, logging and progress bar."""
    return Trainer(
        frame_skip=1,
        logger=make_loggers(list(config.logging.loggers), run_dir, config.logging.project),
        progress_bar=config.logging.progress,
        log_interval=config.logging.interval,
        save_trainer_interval=config.logging.checkpoint_interval,
        checkpoint=checkpoint,
        checkpoint_rotation=make_rotation(run_dir),
        **parts,
    )
