"""What checksums and fsync take of a checkpoint: with and without them, in turns.

    python -m benchmarks.checkpoints [--rows 100000] [--rounds 20] [--folder DIR]

A run of `sac` on the door with the networks of `default` and a main buffer of so many rows. Each
round writes a checkpoint of each kind; medians over rounds count. `plain` leaves the files to the
system, `flushed` waits until the disk has them, `summed` is what a run does: both.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import torch

from configs import compose
from pipeline.build import build_run
from pipeline.files import checkpoint, sums
from pipeline.trainer import Run


def full_run(rows: int, folder: Path) -> Run:
    """A run whose main buffer holds ``rows`` random rows."""
    recipe = compose(
        "variant=sac", "preset=default", f"collector.total_frames={rows}", "torch_threads=1",
        "env.num_threads=1", "logging.loggers=[]", "logging.progress=false",
        f"cache_dir='{folder / 'cache'}'", "compile_updates=false",
    )  # fmt: skip
    run = build_run(recipe, folder / "run")
    collected = next(iter(run.trainer.collector))
    run.trainer._process_batch_hook(collected)
    buffer = run.trainer._modules["main_buffer"]
    one = buffer[:]
    while len(buffer) < rows:
        more = one[: rows - len(buffer)].clone()
        buffer.extend(more.apply(lambda v: torch.rand_like(v) if v.is_floating_point() else v))
    return run


def flushed(folder: Path) -> None:
    """Files and folders on the disk, without their checksums."""
    for path in folder.rglob("*"):
        sums.flush(path)
    sums.flush(folder)


def measure(run: Run, folder: Path, rounds: int) -> dict[str, float]:
    """Seconds of a checkpoint of each kind."""
    kinds: dict[str, Callable[[Path], None]] = {
        "plain": lambda _: None, "flushed": flushed, "summed": sums.write_sums,
    }  # fmt: skip
    saved = run.trainer._sync_checkpoint_components()
    seconds: dict[str, list[float]] = {kind: [] for kind in kinds}
    for number in range(rounds + 1):
        order = list(kinds) if number % 2 else list(kinds)[::-1]
        for kind in order:
            with mock.patch.object(checkpoint, "write_sums", kinds[kind]):
                began = time.perf_counter()
                saved.save(folder / kind, metadata={"collected_frames": 0})
                took = time.perf_counter() - began
            if number:  # the first is warm-up
                seconds[kind].append(took)
            shutil.rmtree(folder / kind)
    return {f"{kind}_s": statistics.median(taken) for kind, taken in seconds.items()}


def main() -> None:
    """Prints a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--folder", type=Path, help="on the disk in question; a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        run = full_run(given.rows, Path(folder))
        found = measure(run, Path(folder), given.rounds)
    share = found["summed_s"] / found["plain_s"] - 1.0
    sys.stdout.write(json.dumps({"rows": given.rows, **found, "share": share}) + "\n")


if __name__ == "__main__":
    main()
