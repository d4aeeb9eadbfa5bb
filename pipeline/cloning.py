"""Behaviour cloning: the `bc` row, the start of other actors, and ILD's demonstrator."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
from pathlib import Path

from filelock import FileLock
from torchrl.modules import ProbabilisticActor

from envs import Task
from pipeline.act.policy_wrappers import acting_policy, unwrapped
from pipeline.compute import hidden_dtype, replays_updates
from pipeline.data.buffers import DemonstrationDistribution, make_core_buffer
from pipeline.data.demonstrations import Demonstrations, make_normalizer
from pipeline.data.mixture import DRAWS, BatchPart, Mixture
from pipeline.files.checkpoint import (
    load_component,
    load_trainer,
    make_checkpoint,
    trained_frames,
)
from pipeline.files.curves import cut_back
from pipeline.files.run_format import latest_of
from pipeline.files.simulator_steps import ExtraSimulatorSteps
from pipeline.files.sums import DamagedError
from pipeline.files.time_use import TimeUse
from pipeline.hooks import UpdatesHook
from pipeline.learn.critics import make_critic
from pipeline.learn.imitation import ImitationStepper
from pipeline.learn.loss import make_loss
from pipeline.learn.networks import make_policy
from pipeline.machine.interruption import StopRequest
from pipeline.machine.random_state import kept_random_state
from pipeline.offline import OfflineStream
from pipeline.playing import make_training_env
from pipeline.recipe import Recipe
from pipeline.run_dir import create_run_dir
from pipeline.settings import plain
from pipeline.trainer import Run, make_evaluation_hook, make_trainer, seed_everything
from pipeline.updates import CLONING_PORTION, actor_updates

_logger = logging.getLogger(__name__)


def build_offline(
    recipe: Recipe, task: Task, run_dir: Path, demos: Demonstrations | None, time_use: TimeUse
) -> Run:
    """Behaviour cloning (paper, section III-B): updates on D alone."""
    if demos is None:
        raise ValueError("offline=true trains on demonstrations alone: set demos.source.")
    if recipe.sampler.own_sources:
        raise ValueError(
            "offline=true trains on demonstrations alone, and sampler.own_sources would not be "
            "drawn from: leave it out, or set offline=false."
        )
    env = make_training_env(recipe, task)
    normalizer = make_normalizer(recipe.actor, demos)
    dtype = hidden_dtype(recipe)
    actor = make_policy(recipe.actor, env, normalizer, recipe.device, dtype)
    chunk = recipe.actor.chunk
    critic = make_critic(recipe.critic, env, None, recipe.device, chunk=chunk)
    updates = actor_updates(recipe)
    actions = chunk * env.action_spec.shape[-1]
    loss = make_loss(recipe.loss, actor, critic, actions, updates)
    policy = acting_policy(actor, chunk)
    env.close()
    core = DemonstrationDistribution(make_core_buffer(demos.rows, recipe.device))
    mixture = Mixture(
        {"demos": BatchPart(core, recipe.bc.batch_size, is_demo=True)},
        draws=DRAWS,
        device=recipe.device,
    )
    collector = OfflineStream(CLONING_PORTION)
    stop = StopRequest()
    trainer = make_trainer(
        recipe,
        run_dir,
        stop,
        make_checkpoint(policy, collector),
        time_use,
        collector=collector,
        total_frames=recipe.bc.updates,
        optim_steps_per_batch=CLONING_PORTION,
        loss_module=loss,
        optimization_stepper=ImitationStepper(
            loss,
            actor_lr=recipe.bc.lr,
            anneal_updates=updates if recipe.bc.anneal else None,
            cuda_graphs=replays_updates(recipe),
            compile_updates=bool(recipe.compile_updates),
        ),
    )
    optimisation = UpdatesHook(mixture, time_use.timed(mixture, "sample"), stop)
    optimisation.register(trainer)
    beside = ExtraSimulatorSteps(demos.simulator_steps)
    beside.write(run_dir)
    taken = {"simulator_steps": beside.total}
    evaluation = make_evaluation_hook(recipe, task, stop, policy, run_dir, time_use, lambda: taken)
    evaluation.register(trainer)
    return Run(recipe, run_dir, trainer, policy, time_use, evaluation, optimisation, stop)


def behaviour_cloned(
    recipe: Recipe, task: Task, demos: Demonstrations | None, time_use: TimeUse | None = None
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
    bc_recipe = recipe.changed(
        offline=True,
        pretrain=False,
        growth={"self_imitation": False, "bc_model": False},
        curriculum={"reverse": False},
        proposal={"acting": False, "bootstrap": False},
        critic={"hidden": [8], "num_critics": 1},  # not trained offline
        loss={"target_entropy": None},  # nor is the temperature
        sampler={"own_sources": []},
        evaluation={"keep_best": False},
    )
    identity = [
        demos.content_hash,
        recipe.demos.held_out,
        recipe.task.name,
        recipe.seed,
        recipe.device,
        plain(recipe.actor),
        plain(recipe.bc),
        recipe.loss.imitation,
        recipe.loss.action_margin,
        recipe.precision,
        recipe.compile_updates,
        recipe.onednn,
    ]
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:16]
    run_dir = Path(recipe.cache_dir) / f"bc-{digest}"
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    # Runs that start together (a sweep over variants) want the same model: one trains it.
    with kept_random_state(recipe.device), FileLock(f"{run_dir}.lock"):
        if not run_dir.exists():
            create_run_dir(run_dir, bc_recipe)
        checkpoint = _checkpoint_of(run_dir, bc_recipe)
        seed_everything(recipe.seed)
        run = build_offline(bc_recipe, task, run_dir, demos, time_use or TimeUse())
        # One that stands in for a damaged newest one is not yet trained to the end.
        if checkpoint is not None and trained_frames(checkpoint) >= bc_recipe.bc.updates:
            load_component(checkpoint, "policy", run.actor)
        else:
            if checkpoint is not None:
                load_trainer(checkpoint, run.trainer)
            cut_back(run_dir, run.trainer.collected_frames if checkpoint is not None else -1)
            run.train()
    actor = unwrapped(run.actor)
    assert isinstance(actor, ProbabilisticActor)
    return actor


def _checkpoint_of(run_dir: Path, recipe: Recipe) -> Path | None:
    """The newest whole checkpoint of a cached model; where all are damaged, a new directory."""
    try:
        return latest_of(run_dir)
    except DamagedError as error:
        _logger.warning("the cached model is damaged and made again: %s", error)
        shutil.rmtree(run_dir)
        create_run_dir(run_dir, recipe)
        return None
