"""Run directories made by hand: a few files that say what a test needs them to say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from envs.door.definition import TASK
from pipeline.act.metrics import Rollouts, summarise
from pipeline.files.run_files import CONFIG, EVALUATION, LEARNING_CURVE
from pipeline.results.evaluation_files import RunEvaluation, episode_columns, progress_columns

STEPS = 4
STAGES = ("near", "there")


def rollouts(successes: int, episodes: int) -> Rollouts:
    """The first ``successes`` episodes succeed from step 2 on, the next one gets near, others not.

    The return of a success is 10, of another episode 0.
    """
    succeeds = np.arange(episodes) < successes
    success = np.zeros((episodes, STEPS), dtype=bool)
    success[succeeds, 1:] = True
    return Rollouts(
        returns=np.where(succeeds, 10.0, 0.0),
        lengths=np.full(episodes, STEPS),
        success=success,
        progress=success.astype(np.float32),
        stages={"near": np.arange(episodes) <= successes, "there": succeeds},
    )


def curve(*success: float, interval: int = 100, **columns: float) -> list[dict[str, Any]]:
    """Rows of a learning curve."""
    return [
        {"frames": interval * i, "success_once": value, "return_mean": 10 * value, **columns}
        for i, value in enumerate(success)
    ]


def make_run(
    path: Path,
    *,
    seed: int = 0,
    successes: int = 5,
    episodes: int = 10,
    variant: str = "dbc_sac",
    points: list[dict[str, Any]] | None = None,
    task: str = "door",
    frames: int = 40,
    further: dict[str, Any] | None = None,
    overrides: tuple[str, ...] = (),
    **values: Any,
) -> Path:
    """An evaluated run; ``further`` is of its evaluation, ``values`` of its configuration."""
    path.mkdir(parents=True)
    recipe = {"variant": variant, "seed": seed, "task": {"name": task}, **values}
    (path / CONFIG).write_text(yaml.safe_dump(recipe))
    played = rollouts(successes, episodes)
    made_from = {
        "run": str(path),
        "checkpoint": "checkpoint-000000000040",
        "task": task,
        "variant": variant,
        "seed": seed,
        "bc_weight": 1.0,
        "demos": "demos.h5",
        "demos_sha256": "abcdef0123456789",
        "frames": frames,
        "evaluation_seed": 7,
        "overrides": list(overrides),
        "versions": {"git": "0123456789abcdef", "git_dirty": True, "packages": {"torch": "2.0"}},
    }
    metrics = {**summarise(played).as_plain(), **(further or {}), "made_from": made_from}
    columns = episode_columns(TASK, played, seed=7)
    RunEvaluation(metrics, columns, progress_columns(played)).write(path / EVALUATION)
    lines = points if points is not None else curve(0.0, 0.5)
    (path / LEARNING_CURVE).write_text("".join(json.dumps(point) + "\n" for point in lines))
    (path / "time_use.json").write_text(json.dumps({"parts_s": {"updates": 90.0, "setup": 30.0}}))
    return path
