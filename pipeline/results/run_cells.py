"""Cells of the table over tasks, out of evaluated run directories."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from envs import Task, find_task
from envs.registry import imports_of
from pipeline.files import again
from pipeline.files.curves import FRAMES, last_wall_s
from pipeline.files.run_files import CHECKPOINTS, CONFIG, EVALUATION, VERSIONS, RunDirectoryError
from pipeline.files.time_use import TimeUse
from pipeline.recipe import Recipe
from pipeline.results.cells import OWN, Cell
from pipeline.results.demonstrators import Demonstrators, demonstrators
from pipeline.results.evaluation import Evaluation, Versions
from pipeline.results.reading import load_run
from pipeline.results.rows import published_names
from pipeline.results.run_tables import row_name
from pipeline.results.runs import EvaluatedRun
from pipeline.run_dir import saved_recipe
from pipeline.updates import critic_updates

CHECKPOINT: Final = re.compile(r"checkpoint-(\d+)")
SAME: Final = ("variant", "preset", "seed")
"""What evaluation and configuration of a run both tell."""
PRESET: Final = "preset/default"
MULTIPLY: Final = "demos.multiply.enabled"


def find_runs(folders: Sequence[Path]) -> list[Path]:
    """Every run directory in these folders, however deep; a folder may be one itself.

    Raises:
        RunDirectoryError: If a folder holds none.
    """
    found: dict[Path, Path] = {}
    for folder in folders:
        holding = {path.parent for path in folder.rglob(CONFIG)}
        runs = sorted(run for run in holding if run.parent not in holding)  # no RUN/best
        if not runs:
            raise RunDirectoryError(
                f"{folder} holds no run (a folder with {CONFIG}); make them with: make rows"
            )
        found |= {run.resolve(): run for run in runs}
    return list(found.values())


def read_cell(run_dir: Path, listed: Mapping[str, Demonstrators], *, unclean: bool = False) -> Cell:
    """The cell of a run. Task, reward and row are what its files say, not its folders' names.

    Args:
        run_dir: Of an evaluated run.
        listed: Demonstrations of others, by checksum.
        unclean: Whether files that no revision holds may have been at work.

    Raises:
        RunDirectoryError: If it is not evaluated or not to its end, if configuration and evaluation
            are of two runs, or if a file cannot be read or names no revision.
    """
    recipe, run = saved_recipe(run_dir), load_run(run_dir)
    _require_one_run(recipe, run)
    _require_its_end(recipe, run)
    trained_with = _versions(run_dir)
    made_from = run.evaluation.made_from
    if not unclean:
        require_revisions(run)
    demos = demonstrators(made_from, recipe.demos.limit, listed)
    wall_s = TimeUse.read_wall_s(run_dir)
    return Cell(
        task=_short(recipe.task.name),
        reward=reward_of(recipe),
        row=row_of(recipe),
        conditions={
            "preset": recipe.preset,
            "frames": made_from.frames,
            "updates": critic_updates(recipe),
            "simulator_steps": made_from.simulator_steps,
            "wall_s": last_wall_s(run_dir) or None if wall_s is None else wall_s,
            "demonstrations": demos.episodes,
            "demonstrations_by": demos.by,
            "demonstrations_multiplied": recipe.demos.multiply.enabled,
            "torch_threads": recipe.torch_threads,
            "env_threads": recipe.env.num_threads,
            "git": trained_with.get("git"),
            "trained_with": trained_with,
        },
        run=_without_folders(run),
    )


def task_of_ours(recipe: Recipe) -> Task | None:
    """The task, where it is one of ours or of a package's; None for somebody's environment.

    That is not made, which would run its code, only to look at what it offers.
    """
    if ":" in recipe.task.name or imports_of(recipe.task.name, recipe.task.options):
        return None
    return find_task(recipe.task.name)


def row_of(recipe: Recipe) -> str:
    """The row's name, and what its demonstrations lack that the row usually has.

    A run of fewer demonstrations, or without those that its task multiplies by default, is another
    row: ``best, 5 demonstrations``, ``best, not multiplied``.
    """
    name = row_name(recipe.variant, recipe.loss.bc_weight.init, published_names())
    fewer = recipe.demos.limit
    task = task_of_ours(recipe)
    multiplies = task is not None and task.defaults.get(PRESET, {}).get(MULTIPLY, False)
    lacking = {
        f"{fewer} demonstrations": fewer is not None,
        "not multiplied": bool(multiplies) and not recipe.demos.multiply.enabled,
    }
    return ", ".join([name, *(said for said, holds in lacking.items() if holds)])


def reward_of(recipe: Recipe) -> str:
    """The reward that a run was paid, by name."""
    if recipe.env.reward is not None:
        return recipe.env.reward
    task = task_of_ours(recipe)
    return task.rewards[0] if task is not None and task.rewards else OWN


def _short(task: str) -> str:
    """A file's task is called after the file."""
    file, separator, name = task.rpartition(":")
    if task.endswith(".py"):
        return Path(task).name
    return f"{Path(file).name}:{name}" if separator and file.endswith(".py") else task


def _without_folders(run: EvaluatedRun) -> EvaluatedRun:
    task = _short(str(run.evaluation.made_from.task_name))
    content = run.evaluation.content
    made_from = {**content["made_from"], "task": task}
    return replace(run, evaluation_or_none=Evaluation.of({**content, "made_from": made_from}))


def _again(run: EvaluatedRun) -> str:
    return again.evaluate(run.path)


def _require_one_run(recipe: Recipe, run: EvaluatedRun) -> None:
    made_from = run.evaluation.made_from
    told = {key: getattr(made_from, key) for key in SAME} | {"task": made_from.task_name}
    trained = {key: getattr(recipe, key) for key in SAME} | {"task": recipe.task.name}
    if "reward" in made_from.model_fields_set:  # evaluations of before do not say
        told["reward"], trained["reward"] = made_from.reward, recipe.env.reward
    for key, value in trained.items():
        if told[key] != value:
            raise RunDirectoryError(
                f"{run.path}: its {EVALUATION} is of {key} {told[key]!r} and its {CONFIG} of "
                f"{value!r}; make it again with: {_again(run)}"
            )


def _require_its_end(recipe: Recipe, run: EvaluatedRun) -> None:
    name = str(run.evaluation.made_from.checkpoint)
    found = CHECKPOINT.fullmatch(name)
    if found is None:
        raise RunDirectoryError(
            f"{run.path}: its {EVALUATION} is of {name}, which is no checkpoint of a run; make "
            f"it again with: {_again(run)}"
        )
    judged = int(found[1])
    reached = max([judged, *_checkpoints(run.path), *(int(row[FRAMES]) for row in run.curve)])
    if judged < reached:
        raise RunDirectoryError(
            f"{run.path}: its {EVALUATION} is older than the run, of {judged} frames or updates "
            f"where it has {reached}; make it again with: {_again(run)}"
        )
    total = recipe.budget.total
    if judged < total:
        raise RunDirectoryError(
            f"{run.path} has got as far as {judged} of {total} frames or updates; go on with: "
            f"make train RESUME={run.path}, then make eval RUN={run.path}"
        )


def _checkpoints(run_dir: Path) -> list[int]:
    names = (CHECKPOINT.fullmatch(path.name) for path in (run_dir / CHECKPOINTS).glob("*"))
    return [int(found[1]) for found in names if found is not None]


def require_revisions(run: EvaluatedRun) -> None:
    """Whether a revision holds all that trained and evaluated a run.

    Raises:
        RunDirectoryError: If none does, or its files do not say.
    """
    trained = Versions.of(_versions(run.path))
    for what, versions in (("trained", trained), ("evaluated", run.evaluation.made_from.versions)):
        if versions is not None and versions.git and not versions.git_dirty:
            continue
        changed = versions is not None and versions.git
        why = "with changes that no revision holds" if changed else "outside any revision"
        raise RunDirectoryError(
            f"{run.path} was {what} {why}: commit, and make it again, or publish it as it is with "
            "ARGS=--unclean"
        )


def _versions(run_dir: Path) -> Mapping[str, Any]:
    path = run_dir / VERSIONS
    try:
        found = json.loads(path.read_text())
        Versions.of(found)
    except (OSError, ValueError) as error:
        told = error.strerror if isinstance(error, OSError) else error
        raise RunDirectoryError(f"{path} cannot be read ({told}); restore it") from error
    return dict(found)
