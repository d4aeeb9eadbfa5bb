"""What changes the numbers of a run besides its seed: one thing at a time, on a toy.

    python -m benchmarks.determinism [--frames 200] [--compiled]

Plain SAC, networks 256 wide, batches of 256. Each row is a run in which one setting differs from
the first; `rows` counts how many rows of the learning curve are the same, `weights` is the largest
difference of a weight of the policy at the end, and 0 is bit for bit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

from tabulate import tabulate

from configs import compose
from pipeline.build import build_run
from pipeline.files.curves import read_lines
from pipeline.files.run_files import LEARNING_CURVE

TASK: Final = "task.name='tests/toys/reach.py'"
CHANGES: Final = {
    "nothing (the run again)": "torch_threads=1",
    "torch_threads=2": "torch_threads=2",
    "env.num_threads=2": "env.num_threads=2",
    "onednn=true": "onednn=true",
    "logging.interval=7": "logging.interval=7",
    "logging.checkpoint_interval=40": "logging.checkpoint_interval=40",
    "evaluation.interval_episodes=3": "evaluation.interval_episodes=3",
    "seed=1": "seed=1",
}
COMPILED: Final = "compile_updates=true"


def trained(frames: int, folder: Path, change: str) -> tuple[dict, list[dict]]:
    """Weights and curve (without its times) of a run."""
    recipe = compose(
        "variant=sac", "preset=smoke", TASK, f"cache_dir='{folder / 'cache'}'", "onednn=false",
        "torch_threads=1", "env.num_threads=1", "compile_updates=false", "optim.actor_delay=0",
        f"collector.total_frames={frames}", "collector.frames_per_batch=20",
        "actor.hidden=[256,256]", "critic.hidden=[256,256]", "sampler.batch_size=256",
        "optim.updates_per_frame=0.25", "evaluation.interval=40", change,
    )  # fmt: skip
    run = build_run(recipe, folder / "run")
    run.train()
    rows = read_lines(folder / "run" / LEARNING_CURVE)
    for row in rows:
        del row["wall_s"]
    return {name: value.clone() for name, value in run.actor.state_dict().items()}, rows


def main() -> None:
    """Prints a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--compiled", action="store_true", help="also compiled updates: minutes")
    given = parser.parse_args()
    changes = CHANGES | ({COMPILED: COMPILED} if given.compiled else {})
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        weights, curve = trained(given.frames, Path(folder) / "first", "torch_threads=1")
        for number, (name, change) in enumerate(changes.items()):
            others, other_curve = trained(given.frames, Path(folder) / str(number), change)
            apart = max(
                (weights[k].float() - others[k].float()).abs().max().item() for k in weights
            )
            same = sum(a == b for a, b in zip(curve, other_curve, strict=True))
            rows.append([name, f"{same} of {len(curve)}", f"{apart:.1e}" if apart else "0"])
    sys.stdout.write(
        tabulate(rows, headers=["changed", "rows the same", "weights"], tablefmt="github") + "\n"
    )


if __name__ == "__main__":
    main()
