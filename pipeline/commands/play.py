"""``make play``: a trained policy in a window."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from itertools import count
from pathlib import Path

from envs.pictures import HUMAN, SCREENS, Render, RenderingUnavailableError, without_screen
from pipeline.act.evaluation import reset_td
from pipeline.film.choice import Choice
from pipeline.film.performers import LoadedRun
from pipeline.playing import make_evaluator
from pipeline.policy import load_policy


def play(
    run_dir: Path,
    choice: Choice | None = None,
    overrides: Sequence[str] = (),
    *,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.perf_counter,
) -> int:
    """Shows the policy, as it is evaluated, in real time, until the window is closed.

    Args:
        run_dir: A run of a task that can be watched.
        choice: Of the episodes; None is the whole list, one after the other.
        overrides: ``key=value`` on top of its recipe.
        sleep: Waits for so many seconds.
        clock: Tells seconds.

    Returns:
        Episodes that were shown to their end.

    Raises:
        RenderingUnavailableError: If there is no display, or it cannot be used.
        MissingCapabilityError: If the task cannot be filmed.
        ValueError: If it cannot be watched live.
    """
    run = LoadedRun.of(run_dir, overrides)
    render: Render = run.task.require("render", "make play")
    if render.window is None:
        raise ValueError(
            f"task {run.task.name} has no window to watch it in: make a film instead, "
            f"make video RUN={run_dir}"
        )
    _require_screen(run_dir)
    if choice is not None and choice.needs_list:
        run.task.require("starts", choice.needs_list)
    numbers: Iterable[int] = count() if choice is None else choice.numbers(run_dir, run.recipe)
    recipe, task = run.recipe, run.task
    env = task.make_env(recipe.env_options(workers=0, render_mode=HUMAN))
    shown = 0
    try:
        with render.window(env) as window:
            policy, _ = load_policy(recipe, task, run_dir)
            evaluator = make_evaluator(recipe, task, episodes=1)
            with evaluator.acting(policy) as acting:
                for number in numbers:
                    td = env.reset(reset_td(task, env, recipe.evaluation.seed, number))
                    act = acting(number, 1)
                    due = clock()
                    while not td["done"].any():
                        if not window.show():
                            return shown
                        td = env.step_mdp(env.step(act(td)))
                        due += 1.0 / render.steps_per_second
                        sleep(max(0.0, due - clock()))
                    shown += 1
    finally:
        env.close()
    return shown


def _require_screen(run_dir: Path) -> None:
    if without_screen():
        raise RenderingUnavailableError(
            f"there is no display ({' or '.join(SCREENS)}): start make play where there is one "
            f"(over ssh: ssh -X), or make a film, make video RUN={run_dir}"
        )
