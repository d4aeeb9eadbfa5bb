"""``make eval``: a run directory in, the content of ``evaluation.json`` out."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from envs import Task
from envs.contacts import Contacts
from envs.demonstrations.sources import BUNDLED
from pipeline import components
from pipeline.act.contact_recorder import ContactRecorder
from pipeline.act.policy_wrappers import unwrapped
from pipeline.act.recorder import SeesSteps, Together
from pipeline.compute import require_device
from pipeline.files.run_files import versions
from pipeline.files.simulator_steps import ExtraSimulatorSteps
from pipeline.machine.extras import require_extras
from pipeline.policy import PolicyOrigin, load_policy
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import RunEvaluation, episode_columns, progress_columns
from pipeline.run_dir import load_recipe, saved_recipe

if TYPE_CHECKING:
    from torchrl.modules import ProbabilisticActor

    from pipeline.act.likeness import Comparison

COMPARED: Final = 100
"""Episodes that are compared to demonstrations: enough for a median."""


def evaluate_run(
    run_dir: Path, overrides: Sequence[str] = (), episodes: int | None = None
) -> dict[str, Any]:
    """The metrics of :func:`run_evaluation`."""
    return dict(run_evaluation(run_dir, overrides, episodes).metrics)


def run_evaluation(
    run_dir: Path,
    overrides: Sequence[str] = (),
    episodes: int | None = None,
    alike_to: str | None = None,
    strategies: bool | None = None,
) -> RunEvaluation:
    """Evaluates the newest checkpoint of a run.

    Args:
        run_dir: A run directory.
        overrides: ``key=value`` on top of its recipe, e.g. ``evaluation.exploration=sample``.
        episodes: Number of episodes; None is ``evaluation.episodes`` of the run.
        strategies: Whether to tell how it goes about the task; None does where the task records
            contacts.
        alike_to: Source of demonstrations to which the first episodes are compared; None for none.

    Returns:
        The metrics, those that every task has and the task's own, and ``made_from``: what from, its
        frames of training and all simulator steps with them (evaluations apart; None if unknown);
        and what each episode did.

    Raises:
        RunDirectoryError, FileNotFoundError, ValueError: As ``load_recipe`` and ``load_policy`` do.
    """
    recipe = load_recipe(run_dir, list(overrides))
    require_device(recipe.device)
    count = recipe.evaluation.episodes if episodes is None else episodes
    task = recipe.find_task()
    policy, origin = load_policy(recipe, task, run_dir)
    comparison = None if alike_to is None else _comparison(alike_to, task)
    touches = _contacts(task, strategies)
    evaluator = components.make_evaluator(
        recipe, task, episodes=count, contacts=touches is not None
    )
    touched = ContactRecorder()
    seen: list[SeesSteps] = [] if comparison is None else [comparison.recorder]
    rollouts = evaluator.run(policy, Together([*seen, touched] if touches is not None else seen))
    ways = None if touches is None else touched.strategies(touches, rollouts)
    # The density of several actions at once says nothing of one of them.
    actor = cast("ProbabilisticActor", unwrapped(policy)) if recipe.actor.chunk == 1 else None
    margin = recipe.loss.action_margin
    alike = {} if comparison is None else {"likeness": comparison.figures(rollouts, actor, margin)}
    metrics = {
        **evaluator.metrics(rollouts),
        **({} if ways is None or touches is None else {"strategies": ways.figures(touches)}),
        **alike,
        "made_from": made_from(recipe, task, run_dir, origin, overrides),
    }
    return RunEvaluation(
        metrics=metrics,
        episodes=episode_columns(task, rollouts, recipe.evaluation.seed)
        | ({} if ways is None else ways.columns()),
        progress=progress_columns(rollouts),
    )


def _contacts(task: Task, asked: bool | None) -> Contacts | None:
    if asked:
        task.require("contacts", "make eval STRATEGIES=1")
    return None if asked is False else task.contacts


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


def _comparison(source: str, task: Task) -> Comparison:
    require_extras(["dtaidistance"], f"make eval DEMOS={source}")
    from pipeline.act.likeness import Comparison  # noqa: PLC0415 - needs the extra

    return Comparison.to(source, task, COMPARED)


def _sha256(source: str, task: Task) -> str | None:
    """SHA-256 (hex) of a file of demonstrations as it is now; None for other kinds of sources."""
    bundled = task.demos.bundled if task.demos is not None and source == BUNDLED else None
    file = Path(source) if bundled is None else bundled
    if not file.is_file():
        return None
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
