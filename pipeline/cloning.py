"""Behaviour cloning: the `bc` row, the start of other actors, and ILD's demonstrator."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from filelock import FileLock
from omegaconf import OmegaConf
from torchrl.modules import ProbabilisticActor

from configs.schema import Config
from pipeline import components
from pipeline.buffers import DemonstrationDistribution, make_core_buffer
from pipeline.checkpoint import (
    latest_checkpoint,
    load_component,
    load_trainer,
    make_checkpoint,
    make_rotation,
)
from pipeline.components import Demonstrations
from pipeline.compute import hidden_dtype, replays_updates
from pipeline.imitation import ImitationStepper
from pipeline.mixture import DRAWS, Mixture
from pipeline.offline import OfflineStream
from pipeline.random_state import kept_random_state
from pipeline.run_dir import create_run_dir
from pipeline.time_use import TimeUse
from pipeline.trainer import Run, make_evaluation_hook, make_trainer, seed_everything

UPDATES_PER_BATCH = 100
"""Updates between two looks of the trainer at its hooks."""


def build_offline(
    config: Config, run_dir: Path, demos: Demonstrations | None, time_use: TimeUse
) -> Run:
    """Behaviour cloning (paper, section III-B): updates on D alone."""
    if demos is None:
        raise ValueError("offline=true trains on demonstrations alone: set demos.source.")
    env = components.make_training_env(config)
    normalizer = components.make_normalizer(config.actor, demos)
    dtype = hidden_dtype(config)
    actor = components.make_policy(config.actor, env, normalizer, config.device, dtype)
    critic = components.make_critic(config.critic, env, None, config.device)
    updates = components.actor_updates(config)
    loss = components.make_loss(config.loss, actor, critic, env.action_spec.shape[-1], updates)
    env.close()
    core = DemonstrationDistribution(make_core_buffer(demos.rows, config.device))
    mixture = Mixture(
        None,
        core,
        main_rows=0,
        demo_rows=config.bc.batch_size,
        draws=DRAWS,
        device=config.device,
    )
    collector = OfflineStream(UPDATES_PER_BATCH)
    trainer = make_trainer(
        config,
        run_dir,
        make_checkpoint(actor, collector),
        time_use,
        collector=collector,
        total_frames=config.bc.updates,
        optim_steps_per_batch=UPDATES_PER_BATCH,
        loss_module=loss,
        optimization_stepper=ImitationStepper(
            loss,
            actor_lr=config.bc.lr,
            anneal_updates=updates if config.bc.anneal else None,
            cuda_graphs=replays_updates(config),
            compile_updates=bool(config.compile_updates),
        ),
    )
    trainer.register_op("process_optim_batch", time_use.timed(mixture, "sample"))
    make_evaluation_hook(config, actor, run_dir, time_use).register(trainer)
    return Run(config, run_dir, trainer, actor, time_use)


def behaviour_cloned(
    config: Config, demos: Demonstrations | None, time_use: TimeUse | None = None
) -> ProbabilisticActor:
    """The BC model of this configuration: trained once by the offline pipeline, then cached.

    It serves as the start of the actor (``pretrain``) and as the demonstrator of ILD (paper,
    section III-E.1: "the same BC model trained for comparison"). Its training counts in
    ``time_use``, that of the run that asks for it.

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
    identity = [
        demos.content_hash,
        config.demos.held_out,
        config.env.name,
        config.seed,
        config.device,
    ]
    identity += [OmegaConf.to_container(part) for part in (config.actor, config.bc)]
    identity += [config.loss.imitation, config.loss.action_margin, config.precision]
    identity += [config.compile_updates, config.onednn]
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:16]
    run_dir = Path(config.cache_dir) / f"bc-{digest}"
    complete = run_dir / "complete"
    bc_config.run_dir = str(run_dir)
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    # Runs that start together (a sweep over variants) want the same model: one trains it.
    with kept_random_state(config.device), FileLock(f"{run_dir}.lock"):
        if not run_dir.exists():
            create_run_dir(run_dir, bc_config)
        seed_everything(config.seed)
        run = build_offline(bc_config, run_dir, demos, time_use or TimeUse())
        if complete.exists():
            load_component(latest_checkpoint(run_dir), "policy", run.actor)
        else:
            checkpoint = make_rotation(run_dir).latest()
            if checkpoint is not None:
                load_trainer(checkpoint, run.trainer)
            run.train()
            complete.touch()
    return run.actor
