"""Where the episodes of a run are played: those that it learns from, and those that judge it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchrl.envs import EnvBase

from envs import Task
from envs.disturbed import disturbed
from envs.task import PROGRESS, SUCCESS, States, has_column
from pipeline.act.evaluation import Evaluator
from pipeline.data.curriculum import ReverseCurriculum
from pipeline.data.demonstrations import Demonstrations
from pipeline.recipe import Recipe


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
