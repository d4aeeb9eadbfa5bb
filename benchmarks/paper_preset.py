"""How long 100,000 frames of DBC-SAC in the paper's preset take, from the first ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.effort import Effort
from benchmarks.statistics import rounded
from benchmarks.worker import run_once
from configs import compose

CHOSEN = ["variant=dbc_sac", "preset=paper"]
RANDOM_SHARE = 10
"""One in this many measured frames is a random one, as in the preset."""


def extrapolate(
    timed: Mapping[str, float], *, total_frames: int, random_frames: int, evaluations: int
) -> dict[str, float]:
    """Seconds of the whole run from those of its parts.

    Args:
        timed: As ``training.train_and_time`` returns.
        total_frames: Of the whole run.
        random_frames: Of them without updates.
        evaluations: Evaluations and checkpoints of the whole run.
    """
    random = timed["random_s"] / timed["random_frames"]
    learning = timed["learning_s"] / timed["learning_frames"]
    total = (
        timed["opening_s"]
        + random * random_frames
        + learning * (total_frames - random_frames)
        + timed["closing_s"] * evaluations
    )
    return {
        "ms_per_random_frame": rounded(random * 1e3),
        "ms_per_learning_frame": rounded(learning * 1e3),
        "s_per_evaluation_and_checkpoint": rounded(timed["closing_s"]),
        "hours": rounded(total / 3600, 3),
    }


def run(effort: Effort) -> dict[str, Any]:
    """Key ``paper_preset``: hours for the preset's frames."""
    whole = compose(*CHOSEN)
    frames = effort.paper_frames
    random_frames = frames // RANDOM_SHARE
    short = [
        *CHOSEN,
        "precision=auto",
        # As in the whole run, which has updates enough.
        "compile_updates=true",
        f"collector.total_frames={frames}",
        f"collector.random_frames={random_frames}",
        f"evaluation.interval={frames}",
    ]
    timed, decided = run_once(
        "benchmarks.training:train_and_time",
        threads=effort.threads,
        overrides=short,
        random_frames=random_frames,
    )
    total = whole.collector.total_frames
    result = extrapolate(
        timed,
        total_frames=total,
        random_frames=whole.collector.random_frames,
        evaluations=total // whole.evaluation.interval,
    )
    return {
        "paper_preset": effort.as_json(
            **decided,
            variant="dbc_sac",
            measured_frames=frames,
            extrapolated_frames=total,
            **result,
        )
    }
