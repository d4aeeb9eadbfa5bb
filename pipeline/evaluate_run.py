"""``make eval``: a run directory in, the content of ``evaluation.json`` out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline import components
from pipeline.evaluation import as_scalars
from pipeline.policy import load_policy
from pipeline.run_dir import EVALUATION, RunDirectoryError, load_config, versions


def evaluate_run(
    run_dir: Path, overrides: Sequence[str] = (), episodes: int | None = None
) -> dict[str, Any]:
    """Evaluates the newest checkpoint of a run.

    Args:
        run_dir: A run directory.
        overrides: ``key=value`` on top of its config, e.g. ``evaluation.exploration=sample``.
        episodes: Number of episodes; None is ``evaluation.episodes`` of the run.

    Returns:
        The metrics (for the door those of Tables I and II) and ``made_from``: what from.

    Raises:
        RunDirectoryError, FileNotFoundError, ValueError: As ``load_config`` and ``load_policy`` do.
    """
    config = load_config(run_dir, list(overrides))
    count = config.evaluation.episodes if episodes is None else episodes
    policy, origin = load_policy(config, run_dir)
    evaluator = components.make_evaluator(config, episodes=count)
    return {
        **as_scalars(evaluator.run(policy).metrics()),
        "made_from": {
            "run": str(run_dir),
            "checkpoint": origin.name,
            "env": config.env.name,
            "variant": config.variant,
            "preset": config.preset,
            "precision": config.precision,
            "bc_weight": config.loss.bc_weight.init,
            "seed": config.seed,
            "demos": config.demos.source,
            "demos_multiplied": config.demos.multiply.enabled,
            "frames": origin.frames,
            "evaluation_seed": config.evaluation.seed,
            "exploration": config.evaluation.exploration,
            "noise_scale": config.evaluation.noise_scale,
            "versions": versions(),
        },
    }


def load_evaluation(path: Path) -> dict[str, Any]:
    """Reads the evaluation of a run directory, or an evaluation file itself.

    Raises:
        RunDirectoryError: If it is missing or not an evaluation.
    """
    file = path / EVALUATION if path.is_dir() else path
    if not file.is_file():
        raise RunDirectoryError(f"{file} does not exist; make it with: make eval RUN={path}")
    try:
        evaluation: dict[str, Any] = json.loads(file.read_text())
        evaluation["made_from"]["variant"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise RunDirectoryError(
            f"{file} is not an evaluation ({error}); make it again with: make eval RUN={path}"
        ) from error
    return evaluation
