"""Real runs of the trainer inside a worker, timed or weighed."""

from __future__ import annotations

import tempfile
import time
from typing import Any

from benchmarks import ours
from benchmarks.worker import peak_resident_mib
from configs import compose
from pipeline.build import build_run
from pipeline.conversion import make_rows
from pipeline.recipe import Recipe

FIRST_UPDATES = 10
"""Frames with updates after which all that a run compiles is compiled."""


def _config(overrides: list[str], folder: str) -> Recipe:
    quiet = ["logging.progress=false", "logging.loggers=[csv]"]
    return compose(*overrides, *quiet, f"cache_dir={folder}/cache")


def train_and_weigh(overrides: list[str], buffer_frames: int) -> dict[str, float]:
    """Peak resident MiB of a short run, and what its main buffer adds once it is full.

    Args:
        overrides: Of the run.
        buffer_frames: Frames that the main buffer of the whole run holds.
    """
    imports = peak_resident_mib()
    with tempfile.TemporaryDirectory() as folder:
        recipe = _config(overrides, folder)
        build_run(recipe, f"{folder}/run").train()
        # Storage is mapped at once but becomes resident as rows are written.
        unwritten = max(0, buffer_frames - recipe.collector.total_frames)
        row = ours.random_rows(ours.EPISODE, make_rows(recipe)).bytes()
    return {
        "imports_mib": imports,
        "peak_mib": peak_resident_mib(),
        "rest_of_buffer_mib": unwritten * row / ours.EPISODE / 2**20,
    }


def train_and_time(overrides: list[str], random_frames: int) -> list[dict[str, Any]]:
    """Seconds of a run with one frame to a batch, in its parts.

    Returns:
        ``opening_s``: the first frame and the first with updates; ``random_s`` and
        ``random_frames``: the others before the first update; ``learning_s`` and
        ``learning_frames``: the others with updates; ``closing_s``: evaluation and checkpoint at
        the end. After them the ``threads`` and the ``precision`` that the run decided on.
    """
    moments: list[tuple[int, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        run = build_run(_config(overrides, folder), f"{folder}/run")
        trainer = run.trainer
        trainer.register_op(
            "post_steps", lambda: moments.append((trainer.collected_frames, time.perf_counter()))
        )
        began = time.perf_counter()
        run.train()
        ended = time.perf_counter()
    # The trainer updates from the batch on that completes the random frames.
    random = [moment for moment in moments if moment[0] < random_frames]
    first, turning, last = random[0], random[-1], moments[-1]
    warm = moments[len(random) + FIRST_UPDATES - 1]
    timed = {
        # The first frame allocates buffers and loads loggers, the first updates are compiled: once
        # in a run, however long.
        "opening_s": first[1] - began + warm[1] - turning[1],
        "random_frames": float(turning[0] - first[0]),
        "random_s": turning[1] - first[1],
        "learning_frames": float(last[0] - warm[0]),
        "learning_s": last[1] - warm[1],
        "closing_s": ended - last[1],
    }
    return [timed, {"threads": run.recipe.torch_threads, "precision": run.recipe.precision}]
