"""Reinforcement learning with demonstrations: learner, sources, collector and hooks together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from torch import nn
from torchrl.envs import EnvBase
from torchrl.trainers import Trainer

from envs import Task
from envs.steps import counted_steps
from pipeline.act.chosen_starts import BEGUN_AT, ChosenStartsEnv
from pipeline.act.portion_collector import PortionCollector, PortionCut
from pipeline.data.curriculum import CurriculumEpisodes, ReverseCurriculum
from pipeline.data.demonstrations import Demonstrations
from pipeline.data.mixture import BatchPart, Mixture
from pipeline.files.checkpoint import CollectorState, make_checkpoint, resumes_midway
from pipeline.files.simulator_steps import ExtraSimulatorSteps
from pipeline.files.time_use import TimeUse
from pipeline.growth import register_growth, require_growth
from pipeline.hooks import (
    BacktrackHook,
    DemoUpdateHook,
    EpisodeHook,
    StoreHook,
    UpdatesHook,
)
from pipeline.judgement import check_clone
from pipeline.learner import Learner, make_learner
from pipeline.machine.interruption import StopRequest
from pipeline.playing import make_curriculum, make_training_env
from pipeline.recipe import Recipe
from pipeline.sources import (
    Sources,
    make_main,
    make_own_sources,
    make_sources,
    reinforced_rows,
)
from pipeline.trainer import Run, make_evaluation_hook, make_trainer
from pipeline.updates import updates_per_portion
from pipeline.watch.diagnostics import DemonstrationProbe, TrainingState

Figures = Callable[[], Mapping[str, float]]


def build_online(
    recipe: Recipe, task: Task, run_dir: Path, demos: Demonstrations | None, time_use: TimeUse
) -> Run:
    """Reinforcement learning, with whatever help from D the configuration asks for."""
    require_growth(recipe)
    with counted_steps() as replayed:
        env, curricula = _environment(recipe, task, demos)
    main = make_main(recipe, demos)
    own = make_own_sources(recipe, main, demos)
    learner = make_learner(recipe, task, env, demos, reinforced_rows(recipe, own), time_use)
    sources = make_sources(recipe, task, demos, main, own, time_use)
    demonstrated = 0 if demos is None else demos.simulator_steps
    beside = ExtraSimulatorSteps(demonstrated + replayed.taken, sources.simulator_steps)
    beside.write(run_dir)
    policy = learner.policy()
    stop = StopRequest()
    collector = _collector(recipe, env, learner, time_use, stop)
    trainer = make_trainer(
        recipe,
        run_dir,
        stop,
        make_checkpoint(policy, CollectorState(collector)),
        time_use,
        collector=collector,
        total_frames=recipe.collector.total_frames,
        optim_steps_per_batch=updates_per_portion(recipe),
        loss_module=learner.loss,
        optimization_stepper=learner.stepper,
    )
    trainer.register_op("shutdown", partial(_save_cut, trainer, collector))
    optimisation, figures = _register(
        recipe, trainer, env, learner, sources, curricula, time_use, stop
    )
    figures.insert(0, lambda: {"simulator_steps": trainer.collected_frames + beside.total})
    if demos is not None:
        figures.append(DemonstrationProbe(learner.loss, demos.rows, demos.held_out))
    evaluation = make_evaluation_hook(recipe, task, stop, policy, run_dir, time_use, *figures)
    evaluation.register(trainer)
    begin = partial(check_clone, evaluation, recipe, demos) if recipe.pretrain else None
    return Run(
        recipe, run_dir, trainer, policy, time_use, evaluation, optimisation, stop, begin=begin
    )


def _environment(
    recipe: Recipe, task: Task, demos: Demonstrations | None
) -> tuple[EnvBase, list[ReverseCurriculum]]:
    """The collector's environment, and the curriculum that begins its episodes, or none."""
    env = make_training_env(recipe, task)
    curriculum = make_curriculum(recipe, task, env, demos)
    begin = None if curriculum is None else curriculum.begin
    # An actor of chunks has to know when episodes begin.
    if begin is not None or recipe.actor.chunk > 1:
        env = ChosenStartsEnv(env, begin)
    return env, [] if curriculum is None else [curriculum]


def _collector(
    recipe: Recipe, env: EnvBase, learner: Learner, time_use: TimeUse, stop: StopRequest
) -> PortionCollector:
    """Plays ``env`` with the policy that explores."""
    collector = PortionCollector(
        env,
        learner.explorer(),
        frames_per_batch=recipe.collector.frames_per_batch,
        total_frames=-1,  # the trainer counts, so that a resumed run can go on for longer
        init_random_frames=recipe.collector.random_frames,
        policy_device=recipe.device,
        env_device=recipe.device,
        storing_device=recipe.device,
        track_traj_ids=False,
        interruptor=PortionCut(stop),
        auto_register_policy_transforms=False,  # what a policy keeps in mind is in the carrier
    )
    time_use.watch(env, "_step", "physics")
    time_use.watch(collector, "rollout", "collect")
    return collector


def _save_cut(trainer: Trainer, collector: PortionCollector) -> None:
    """Saves a portion that was cut: the trainer saves only when one is complete."""
    if collector.begun is not None:
        trainer.save_trainer(force_save=True)


def _register(
    recipe: Recipe,
    trainer: Trainer,
    env: EnvBase,
    learner: Learner,
    sources: Sources,
    curricula: list[ReverseCurriculum],
    time_use: TimeUse,
    stop: StopRequest,
) -> tuple[UpdatesHook, list[Figures]]:
    """Has ``trainer`` do what happens around its updates, in the order that hooks are called in.

    Returns:
        The hook of the updates, and what every evaluation measures besides.
    """
    device, midway, stepper = recipe.device, resumes_midway(env), learner.stepper
    if learner.average is not None:
        learner.average.register(trainer)
    backtracking = _backtracking(recipe, learner.actors)
    for hook in backtracking:
        hook.register(trainer)
    for one in curricula:
        one.register(trainer)
    admissions = register_growth(recipe, sources.grown, sources.episode_rows, trainer)
    begun = [CurriculumEpisodes(one, BEGUN_AT) for one in curricula]
    episodes = EpisodeHook(*admissions, *backtracking, *begun, resumes_midway=midway, device=device)
    episodes.register(trainer)
    store = StoreHook(sources.main, sources.to_rows, resumes_midway=midway, device=device)
    time_use.watch(store, "store", "store")
    store.register(trainer)
    for name, own in sources.own.items():
        if own.keeps_state:
            trainer.register_module(name, own.source)
    mixture = sources.mixture
    optimisation = UpdatesHook(mixture, time_use.timed(mixture, "sample"), stop)
    optimisation.register(trainer)
    trainer.register_op("post_optim_complete_log", stepper.log_metrics)
    period, rows = recipe.sampler.demo_update_period, recipe.sampler.batch_size
    if period:
        drawn = Mixture({"demos": BatchPart(sources.demos, rows, is_demo=True)}, device=device)
        DemoUpdateHook(stepper, drawn, period).register(trainer)
    return optimisation, [
        TrainingState(stepper),
        episodes.averages,
        *[hook.counted for hook in backtracking],
        *[one.progress for one in curricula],
    ]


def _backtracking(recipe: Recipe, modules: list[nn.Module]) -> list[BacktrackHook]:
    """The hook over ``modules``, or none."""
    backtrack = recipe.backtrack
    if backtrack.level is None:
        return []
    hook = BacktrackHook(modules, backtrack.level, window=backtrack.window, memory=backtrack.memory)
    return [hook]
