"""What a long run does to memory, open files, speed and logs: a million frames of a small one.

    python -m benchmarks.endurance [--frames 1000000] [--task tests/toys/reach.py] [--out FILE]

`sac` with networks 8 wide, a buffer that is soon full, 64 copies, an update for every 128 frames,
and evaluations, checkpoints and logs as often as any run has them. It samples the process at every
evaluation. The first tenth is warm-up. Speed is frames a second of the process's own CPU time,
which a busy machine hardly changes.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Final

import torch

from configs import compose
from pipeline.build import build_run

WARM_UP: Final = 0.1
"""Of the samples."""
PORTION: Final = 1_280
Sample = dict[str, float]


def sample(frames: int, run_dir: Path) -> Sample:
    """The process as it is now, and how large its directory is."""
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    sizes = {path: path.stat().st_size for path in run_dir.rglob("*") if path.is_file()}
    saved = sum(size for path, size in sizes.items() if "checkpoints" in path.parts)
    return {
        "frames": frames,
        "cpu_s": time.process_time(),
        "resident_mib": resident / 2**20,
        "open_files": len(list(Path("/proc/self/fd").iterdir())),
        "threads": len(list(Path("/proc/self/task").iterdir())),
        "checkpoints_mib": saved / 2**20,
        "logs_mib": (sum(sizes.values()) - saved) / 2**20,
    }


def trained(frames: int, task: str, folder: Path, out: Path | None) -> list[Sample]:
    """Samples of a run of so many frames, a hundred of them; each is appended to ``out``."""
    every = max(PORTION, frames // 100)
    recipe = compose(
        "variant=sac", "preset=smoke", f"task.name='{task}'", f"cache_dir='{folder / 'cache'}'",
        "torch_threads=1", "env.num_envs=64", f"collector.total_frames={frames}",
        f"collector.frames_per_batch={PORTION}", "actor.hidden=[8]", "critic.hidden=[8]",
        f"optim.updates_per_frame={1 / 128}", "sampler.capacity=20000",
        f"evaluation.interval={every}",
        "evaluation.interval_episodes=4", f"logging.checkpoint_interval={every}",
        "logging.interval=1000", "logging.loggers=[csv,tensorboard]",
    )  # fmt: skip
    run = build_run(recipe, folder / "run")
    samples: list[Sample] = []

    def look() -> None:
        done = run.trainer.collected_frames
        if not samples or done - samples[-1]["frames"] >= every:
            samples.append(sample(done, run.run_dir))
            if out is not None:
                with out.open("a") as file:
                    file.write(json.dumps(samples[-1]) + "\n")

    run.trainer.register_op("post_steps", look)
    run.train()
    return samples


def judged(samples: list[Sample]) -> dict[str, float]:
    """How the last quarter stands beside the first after the warm-up."""
    warm = samples[int(len(samples) * WARM_UP) :]
    quarter = max(1, len(warm) // 4)

    def change(values: list[float]) -> float:
        return statistics.median(values[-quarter:]) / statistics.median(values[:quarter]) - 1.0

    speeds = [(b["frames"] - a["frames"]) / (b["cpu_s"] - a["cpu_s"]) for a, b in pairwise(warm)]
    last = samples[-1]
    return {
        "frames": last["frames"],
        "cpu_min": last["cpu_s"] / 60,
        "resident_mib": last["resident_mib"],
        "resident_change": change([one["resident_mib"] for one in warm]),
        "frames_per_cpu_s": statistics.median(speeds),
        "speed_change": change(speeds),
        "open_files_first": warm[0]["open_files"],
        "open_files_last": last["open_files"],
        "threads_first": warm[0]["threads"],
        "threads_last": last["threads"],
        "checkpoints_mib": last["checkpoints_mib"],
        "logs_mib": last["logs_mib"],
        "log_bytes_per_frame": last["logs_mib"] * 2**20 / last["frames"],
    }


def main() -> None:
    """Prints a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--task", default="tests/toys/reach.py")
    parser.add_argument("--out", type=Path, help="where the samples go, a line of JSON for each")
    given = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        samples = trained(given.frames, given.task, Path(folder), given.out)
    sys.stdout.write(json.dumps({"task": given.task, **judged(samples)}) + "\n")


if __name__ == "__main__":
    main()
