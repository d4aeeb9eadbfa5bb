"""``make smoke``: trains and evaluates variants for a few seconds each.

    python -m tests.smoke VARIANT... [--jobs 2] [--episodes 4] [--task TASK] [-- KEY=VALUE...]

Every command is the one that users type, in a process of its own. That process is forked from one
that has loaded torch and the simulators: loading them takes longer than the training itself.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import bcsac
from pipeline.files.run_files import EVALUATION

LOADED_ONCE = [
    *("hydra", "mujoco", "pandas", "scipy.stats"),
    *("envs.door", "pipeline.build", "pipeline.cli", "pipeline.commands.evaluate_run"),
]


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs them; the exit code is 1 if one failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.smoke", description=__doc__)
    parser.add_argument("variants", nargs="+", metavar="VARIANT")
    parser.add_argument("--jobs", type=int, default=2, help="at the same time")
    parser.add_argument("--episodes", type=int, default=4, help="of each evaluation")
    parser.add_argument("--task", help="of all of them; the door without it")
    given = list(sys.argv[1:] if arguments is None else arguments)
    end = given.index("--") if "--" in given else len(given)
    asked = parser.parse_args(given[:end])
    multiprocessing.get_context("forkserver").set_forkserver_preload(LOADED_ONCE)
    with tempfile.TemporaryDirectory() as runs, ThreadPoolExecutor(asked.jobs) as pool:
        settings = given[end + 1 :]
        one = partial(
            smoke, Path(runs), task=asked.task, settings=settings, episodes=asked.episodes
        )
        failed = [
            name
            for name, whole in zip(asked.variants, pool.map(one, asked.variants), strict=True)
            if not whole
        ]
    if failed:
        sys.exit(f"make smoke: {', '.join(failed)} failed")


def smoke(
    runs: Path, variant: str, *, task: str | None, settings: Sequence[str], episodes: int
) -> bool:
    """Trains and evaluates a variant below ``runs``, and prints what that printed when it is over.

    Returns:
        Whether both ended well and left an evaluation.
    """
    began = time.monotonic()
    run, log = runs / variant, runs / f"{variant}.log"
    trained, judged = ([], []) if task is None else ([f"task.name='{task}'"], ["--task", task])
    commands = [
        ["train", f"variant={variant}", "preset=smoke", f"run_dir={run}", *trained, *settings],
        ["eval", str(run), "--episodes", str(episodes), *judged],
    ]
    whole = all(_ends_well(command, log) for command in commands)
    whole = whole and (run / EVALUATION).is_file()
    end = f"took {time.monotonic() - began:.0f} s" if whole else "failed"
    print(f"==== smoke: {variant}\n{log.read_text()}==== smoke: {variant} {end}", flush=True)
    return whole


def _ends_well(command: Sequence[str], log: Path) -> bool:
    process = multiprocessing.get_context("forkserver").Process(target=_run, args=(command, log))
    process.start()
    process.join()
    return process.exitcode == 0


def _run(command: Sequence[str], log: Path) -> None:
    """The command ``bcsac``, with what it prints in ``log``."""
    with log.open("a") as file:
        os.dup2(file.fileno(), sys.stdout.fileno())
        os.dup2(file.fileno(), sys.stderr.fileno())
    sys.argv = ["bcsac", *command]
    bcsac.main()


if __name__ == "__main__":
    main()
