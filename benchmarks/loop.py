"""Frames per second of ``make train`` in the default preset, and where its time goes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.effort import Effort
from benchmarks.statistics import rounded
from benchmarks.worker import THREAD_VARIABLES

TIME_USE = "time_use.json"
PRODUCTIVE = ("physics", "update", "demonstrations", "evaluate")
"""Parts that are updates or the simulator's work: frames, played demonstrations, evaluations.

Updates are those of pretraining too. An evaluation takes 1.1 times what its physics alone takes
(section ``evaluation``).
"""
TOLERANCE = 0.01
"""By how much, relative to the wall time, the parts may miss it."""


def summarise(time_use: Mapping[str, Any], frames: int) -> dict[str, Any]:
    """Shares and frame costs from what a training run wrote.

    Raises:
        ValueError: If the parts do not sum to the wall time.
    """
    wall = float(time_use["wall_s"])
    parts = {name: float(seconds) for name, seconds in time_use["parts_s"].items()}
    if abs(sum(parts.values()) - wall) > TOLERANCE * wall:
        raise ValueError(
            f"the parts in {TIME_USE} sum to {sum(parts.values()):.2f} s, but wall_s is {wall:.2f}"
        )
    productive = sum(parts.get(name, 0.0) for name in PRODUCTIVE)
    return {
        "wall_s": rounded(wall),
        "parts_s": {name: rounded(seconds) for name, seconds in parts.items()},
        "share": {name: rounded(seconds / wall, 3) for name, seconds in parts.items()},
        "productive_share": rounded(productive / wall, 3),
        "overhead_share": rounded(1.0 - productive / wall, 3),
        "frames_per_s": rounded(frames / wall),
    }


def run(effort: Effort) -> dict[str, Any]:
    """Key ``train_breakdown``: of a run from scratch, with nothing cached.

    Raises:
        RuntimeError: If training fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder) / "run"
        began = time.perf_counter()
        training = subprocess.run(
            [
                sys.executable,
                *("-m", "pipeline.train", "preset=default"),
                f"run_dir={run_dir}",
                f"cache_dir={folder}/cache",
                f"collector.total_frames={effort.train_frames}",
                "logging.progress=false",
            ],
            env={**os.environ, **dict.fromkeys(THREAD_VARIABLES, str(effort.threads))},
            capture_output=True,
            text=True,
            check=False,
        )
        process_s = time.perf_counter() - began
        if training.returncode != 0:
            raise RuntimeError(f"training failed:\n{training.stdout}\n{training.stderr}")
        path = run_dir / TIME_USE
        time_use = json.loads(path.read_text()) if path.is_file() else None
    result = effort.as_json(
        preset="default",
        precision="as configured by the preset",
        frames=effort.train_frames,
        process_s=rounded(process_s),
    )
    if time_use is None:
        # Runs of versions before that file existed can still be timed as a whole.
        result["note"] = f"the run wrote no {TIME_USE}: no breakdown"
        result["frames_per_s"] = rounded(effort.train_frames / process_s)
    else:
        result |= summarise(time_use, effort.train_frames)
    return {"train_breakdown": result}
