"""``make eval``: a run directory in, the content of ``evaluation.json`` out."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from envs import Task
from envs.demonstrations.sources import BUNDLED
from pipeline.act.recorder import Together
from pipeline.commands.extras import AskedFor, Subject
from pipeline.commands.extras.strategies import StrategiesAsked
from pipeline.compute import require_device
from pipeline.files.run_files import versions
from pipeline.files.simulator_steps import ExtraSimulatorSteps
from pipeline.playing import make_evaluator
from pipeline.policy import PolicyOrigin, load_policy
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import RunEvaluation, episode_columns, progress_columns
from pipeline.run_dir import load_recipe, saved_recipe


def evaluate_run(
    run_dir: Path, overrides: Sequence[str] = (), episodes: int | None = None
) -> dict[str, Any]:
    """The metrics of :func:`run_evaluation`."""
    return dict(run_evaluation(run_dir, overrides, episodes).metrics)


def run_evaluation(
    run_dir: Path,
    overrides: Sequence[str] = (),
    episodes: int | None = None,
    extras: Sequence[AskedFor] = (StrategiesAsked(),),
) -> RunEvaluation:
    """Evaluates the newest checkpoint of a run.

    Args:
        run_dir: A run directory.
        overrides: ``key=value`` on top of its recipe, e.g. ``evaluation.exploration=sample``.
        episodes: Number of episodes; None is ``evaluation.episodes`` of the run.
        extras: What is told besides, in this order.

    Returns:
        The metrics, those that every task has, the task's own and those of the extras, and
        ``made_from``: what from, its frames of training and all simulator steps with them
        (evaluations apart; None if unknown); and what each episode did.

    Raises:
        RunDirectoryError, FileNotFoundError, ValueError: As ``load_recipe`` and ``load_policy`` do.
    """
    recipe = load_recipe(run_dir, list(overrides))
    require_device(recipe.device)
    count = recipe.evaluation.episodes if episodes is None else episodes
    task = recipe.find_task()
    policy, origin = load_policy(recipe, task, run_dir)
    subject = Subject(recipe, task, policy)
    told = [extra for asked in extras if (extra := asked(subject)) is not None]
    options = {key: value for extra in told for key, value in extra.env_options.items()}
    evaluator = make_evaluator(recipe, task, episodes=count, **options)
    rollouts = evaluator.run(policy, Together([extra.recorder for extra in told]))
    metrics = dict(evaluator.metrics(rollouts))
    columns = episode_columns(task, rollouts, recipe.evaluation.seed)
    for extra in told:
        found = extra.findings(rollouts)
        metrics |= found.metrics
        columns |= {name: list(values) for name, values in found.columns.items()}
    metrics["made_from"] = made_from(recipe, task, run_dir, origin, overrides)
    return RunEvaluation(metrics, columns, progress_columns(rollouts))


def made_from(
    recipe: Recipe, task: Task, run_dir: Path, origin: PolicyOrigin, overrides: Sequence[str]
) -> dict[str, Any]:
    """What figures of a policy were made from: the run, its budget, seeds and versions."""
    beside, trained = ExtraSimulatorSteps.read(run_dir), saved_recipe(run_dir)
    return {
        "run": str(run_dir),
        "checkpoint": origin.name,
        "task": recipe.task.name,
        "reward": recipe.env.reward,
        # What an override says beside these counts for the evaluation, and not for the training.
        "variant": trained.variant,
        "preset": trained.preset,
        "precision": trained.precision,
        "bc_weight": trained.loss.bc_weight.init,
        "seed": trained.seed,
        "demos": trained.demos.source,
        "demos_sha256": _sha256(trained.demos.source, task),
        "demos_multiplied": trained.demos.multiply.enabled,
        "frames": origin.frames,
        "simulator_steps": None if beside is None else origin.frames + beside.total,
        "evaluation_seed": recipe.evaluation.seed,
        "exploration": recipe.evaluation.exploration,
        "noise_scale": recipe.evaluation.noise_scale,
        "overrides": list(overrides),
        "versions": versions(),
    }


def _sha256(source: str, task: Task) -> str | None:
    """SHA-256 (hex) of a file of demonstrations as it is now; None for other kinds of sources."""
    bundled = task.demos.bundled if task.demos is not None and source == BUNDLED else None
    file = Path(source) if bundled is None else bundled
    if not file.is_file():
        return None
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
