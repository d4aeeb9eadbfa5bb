"""Run directories made by hand: what training and `make eval` leave, in a few small files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.files.run_files import EVALUATION, LEARNING_CURVE, VERSIONS
from pipeline.files.time_use import TIME_USE
from pipeline.recipe import Recipe
from pipeline.results.evaluation import Evaluation
from pipeline.results.evaluation_files import save_evaluation
from pipeline.run_dir import save_recipe

REVISION = {"git": "a" * 40, "git_dirty": False, "packages": {"torch": "2"}}
# 5 portions of 20 frames, of which the first comes before learning: 4 times 20 / 2 updates.
SMALL: Mapping[str, Any] = {
    "variant": "bc_sac",
    "preset": "table",
    "torch_threads": 1,
    "env": {"num_envs": 1, "num_threads": 1},
    "optim": {"updates_per_frame": 0.5},
    "collector": {"total_frames": 100, "frames_per_batch": 20, "random_frames": 40},
    "loss": {"bc_weight": {"kind": "constant", "init": 1.0}},
}
CURVE = ({"frames": 0, "return_mean": 1.0, "wall_s": 2.0, "stages": {"near": 0.5}},
         {"frames": 100, "return_mean": 3.0, "wall_s": 9.0, "stages": {"near": 1.0}})  # fmt: skip


def recipe(**changes: Any) -> Recipe:
    """A small one of the hammer."""
    return Recipe().changed(**SMALL).changed(task={"name": "hammer"}).changed(**changes)


def made_from(given: Recipe, run_dir: Path) -> dict[str, Any]:
    """What `make eval` says of its run."""
    return {
        "run": str(run_dir),
        "checkpoint": "checkpoint-000000000100",
        "task": given.task.name,
        "reward": given.env.reward,
        "variant": given.variant,
        "preset": given.preset,
        "bc_weight": given.loss.bc_weight.init,
        "seed": given.seed,
        "demos": "/somewhere/else/demos.pickle",
        "demos_sha256": "b" * 64,
        "demos_multiplied": given.demos.multiply.enabled,
        "frames": 100,
        "simulator_steps": 130,
        "evaluation_seed": 20_000,
        "exploration": "mean",
        "noise_scale": 1.0,
        "overrides": [f"task.name='{given.task.name}'"],
        "versions": dict(REVISION),
    }


def evaluation_of(made_from: Mapping[str, Any], **figures: Any) -> Evaluation:
    """Of a run of which only that is said which a test asks for."""
    needed = {"run": "runs/x", "variant": "bc", "seed": 0}
    return Evaluation.of({"episodes": 100, **figures, "made_from": {**needed, **made_from}})


def evaluated(run_dir: Path, given: Recipe | None = None, **figures: Any) -> Path:
    """Writes a run of 100 frames that succeeds in 9 of 10 episodes; returns its directory."""
    given = recipe() if given is None else given
    run_dir.mkdir(parents=True)
    save_recipe(run_dir, given)
    (run_dir / VERSIONS).write_text(json.dumps(REVISION))
    (run_dir / TIME_USE).write_text(json.dumps({"wall_s": 12.5, "parts_s": {"other": 12.5}}))
    (run_dir / LEARNING_CURVE).write_text("".join(json.dumps(row) + "\n" for row in CURVE))
    (run_dir / "checkpoints" / "checkpoint-000000000100").mkdir(parents=True)
    evaluation = {
        "episodes": 10,
        "return_mean": 3.0,
        "return_std": 1.0,
        "success_once": 0.9,
        "success_at_end": 0.5,
        "steps_to_success_median": 41.0,
        "success_share": 0.25,
        "stages": {"near": 1.0},
        "made_from": made_from(given, run_dir),
    }
    save_evaluation(run_dir / EVALUATION, evaluation | figures)
    return run_dir
