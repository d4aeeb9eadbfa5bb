"""How much the door differs between two versions of MuJoCo: the same actions in both.

::

    python -m benchmarks.mujoco_versions play a.npz          # in an environment with one version
    python -m benchmarks.mujoco_versions play b.npz          # in one with the other
    python -m benchmarks.mujoco_versions compare a.npz b.npz
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs import find_task
from envs.adroit.simulator import HandSimulator
from envs.demonstrations import DemoOptions, load_demonstrations
from envs.door import task
from envs.door.hand import DOOR, DOOR_POSITION

SEQUENCES = 100
NOISE = 0.1
"""Standard deviation of what is added to the actions once the demonstrations are used up."""


def play() -> NDArray[np.float32]:
    """Observations [SEQUENCES, T + 1, 38] of the bundled demonstrations' actions at their doors."""
    episodes = load_demonstrations(
        "bundled", find_task("door"), DemoOptions(resimulate=False)
    ).episodes
    length = min(len(episode.actions) for episode in episodes)
    chosen = [episodes[index % len(episodes)] for index in range(SEQUENCES)]
    actions = np.stack([episode.actions[:length] for episode in chosen]).astype(np.float64)
    noise = np.random.default_rng(0).normal(scale=NOISE, size=actions.shape)
    noise[: len(episodes)] = 0.0
    doors = np.array([episode.start[DOOR_POSITION] for episode in chosen])
    with HandSimulator(DOOR, SEQUENCES, 1) as simulator:
        first = simulator.start({DOOR_POSITION: doors})
        rest = [simulator.step(actions[:, t] + noise[:, t]) for t in range(length)]
    return np.stack([first, *(after.copy() for after in rest)], axis=1)


def compare(left: Path, right: Path) -> str:
    """What two files of :func:`play` have in common and what not, in lines."""
    files = [np.load(path) for path in (left, right)]
    observations = [file["observations"] for file in files]
    gap = np.abs(observations[0] - observations[1]).max(axis=2)
    lines = [
        f"{observations[0].shape[0]} sequences of {gap.shape[1] - 1} steps; "
        "largest difference of an observation:"
    ]
    lines += [
        f"  step {step:3d}: median {np.median(gap[:, step]):.2g}, max {gap[:, step].max():.2g}"
        for step in (1, 10, 50, 100, gap.shape[1] - 1)
    ]
    for file, seen in zip(files, observations, strict=True):
        returns = task.reward(seen[:, 1:]).sum(axis=1)
        widest = seen[:, 1:, task.HINGE].max(axis=1)
        opened = int((widest > task.SUCCESS_ANGLE).sum())
        error = returns.std(ddof=1) / len(returns) ** 0.5
        lines.append(
            f"MuJoCo {file['version']}: {opened} doors above {task.SUCCESS_ANGLE} rad, "
            f"mean return {returns.mean():.1f} (standard error {error:.1f})"
        )
    return "\n".join(lines)


def main() -> None:
    """Plays, or compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["play", "compare"])
    parser.add_argument("files", nargs="+", type=Path)
    chosen = parser.parse_args()
    if chosen.what == "play":
        np.savez(chosen.files[0], observations=play(), version=mujoco.__version__)
    else:
        sys.stdout.write(compare(*chosen.files) + "\n")


if __name__ == "__main__":
    main()
