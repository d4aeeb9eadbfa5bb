"""What checksums and fsync take of a checkpoint: with and without them, in turns.

    python -m benchmarks.checkpoints [--rows 100000] [--rounds 20] [--updates 100] [--folder DIR]

A run of `sac` on the door with the networks of `default` and a main buffer of so many rows. Each
round writes a checkpoint of each kind and makes updates; medians over rounds count. `plain` leaves
the files to the system, `in_the_loop` takes checksums and waits for the disk before it goes on, and
`beside` is what a run does: the same beside the updates. `held` is how long the training stands
still for the checkpoint, `with_updates` how long the checkpoint and the updates take together.
"""

from __future__ import annotations

import argparse
import json
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
from pipeline.files import rotation as rotations
from pipeline.files.rotation import SealedRotation, seal
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


def plain(stage: Path, destination: Path) -> None:
    """Neither checksums nor the disk."""
    stage.rename(destination)


def measure(run: Run, folder: Path, rounds: int, updates: int) -> dict[str, dict[str, float]]:
    """Seconds by kind of checkpoint."""
    kinds: dict[str, tuple[Callable[[Path, Path], None], bool]] = {
        "plain": (plain, True), "in_the_loop": (seal, True), "beside": (seal, False),
    }  # fmt: skip
    saved = run.trainer._sync_checkpoint_components()
    run.trainer.optim_steps_per_batch = updates
    rotation = SealedRotation(folder / "checkpoints", keep_last=2)
    seconds: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for number in range(rounds + 1):
        order = list(kinds) if number % 2 else list(kinds)[::-1]
        for place, kind in enumerate(order):
            sealed, waits = kinds[kind]
            with mock.patch.object(rotations, "seal", sealed):
                began = time.perf_counter()
                rotation.save(saved, step=number * len(kinds) + place)
                if waits:
                    rotation.sealing.settle()
                held = time.perf_counter() - began
                run.trainer.optim_steps(None)
                taken = time.perf_counter() - began
                rotation.sealing.settle()
            if number:  # the first is warm-up
                seconds[kind].append((held, taken))
    names = ("held", "with_updates")
    return {
        kind: {
            name: statistics.median(at)
            for name, at in zip(names, zip(*of, strict=True), strict=True)
        }
        for kind, of in seconds.items()
    }


def main() -> None:
    """Prints a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--updates", type=int, default=100, help="after each checkpoint")
    parser.add_argument("--folder", type=Path, help="on the disk in question; a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        run = full_run(given.rows, Path(folder))
        found = measure(run, Path(folder), given.rounds, given.updates)
    without = found["plain"]["held"]
    share = {kind: of["held"] / without - 1.0 for kind, of in found.items()}
    sys.stdout.write(json.dumps({"rows": given.rows, **found, "share_held": share}) + "\n")


if __name__ == "__main__":
    main()
