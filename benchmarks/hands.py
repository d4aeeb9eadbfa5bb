"""The four hand tasks: what DAPG's published policies reach in them, and how fast they step.

    python -m benchmarks.hands success FOLDER    # of NAME.npz: weights of DAPG's policies as arrays
    python -m benchmarks.hands speed

An archive holds the layers ``w0 b0 w1 b1 w2 b2`` and the shifts and scales of input and output
(``in_shift in_scale out_shift out_scale``); published by Rajeswaran et al. (2018) as pickles in
github.com/aravindr93/hand_dapg, ``dapg/policies``.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import mujoco
import numpy as np
import torch
import typer
from numpy.typing import NDArray
from tabulate import tabulate
from tensordict import TensorDictBase

from benchmarks.environment import CALL_STEPS
from benchmarks.statistics import spread
from benchmarks.worker import Entry, available_cores, race
from envs import EnvOptions, Task, find_task
from envs.adroit.scene import SUBSTEPS
from envs.adroit.torchrl_env import HandEnv

HANDS: Final = ("door", "hammer", "pen", "relocate")
SEED: Final = 20000
"""Of the evaluation's list of episodes."""
BATCH: Final = 100
COPIES: Final = 64

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class Weights:
    """The mean action of a published policy.

    Args:
        path: Its archive.
    """

    def __init__(self, path: Path) -> None:
        self.of = dict(np.load(path))

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        """Actions [N, A] in [-1, 1] for observations [N, O]."""
        of = self.of
        missing = len(of["in_shift"]) - observation.shape[1]
        if missing:  # DAPG's door has a flag that the paper's has not: whether it is open
            flag = np.where(observation[:, 28:29] > 1.35, 1.0, -1.0)
            observation = np.append(observation, flag, axis=1)
        hidden = (observation - of["in_shift"]) / (of["in_scale"] + 1e-8)
        for layer in "01":
            hidden = np.tanh(hidden @ of[f"w{layer}"].T + of[f"b{layer}"])
        action = (hidden @ of["w2"].T + of["b2"]) * of["out_scale"] + of["out_shift"]
        return action.clip(-1.0, 1.0)


@dataclass(frozen=True)
class Reached:
    """What a policy reached in some episodes."""

    success: NDArray[np.bool_]
    """Whether each succeeded at any step."""
    returns: NDArray[np.float64]


def play(task: Task, policy: Weights, episodes: int) -> Reached:
    """Plays the first episodes of the evaluation's list."""
    success, returns = [], []
    for first in range(0, episodes, BATCH):
        count = min(BATCH, episodes - first)
        env = task.make_env(EnvOptions(num_envs=count))
        assert task.starts is not None
        td: TensorDictBase = env.reset(task.starts(SEED, first, count))
        seen, total = torch.zeros(count, dtype=torch.bool), torch.zeros(count, dtype=torch.float64)
        while not td["done"].any():
            action = torch.as_tensor(policy(td["observation"].numpy()))
            td = env.step(td.set("action", action))["next"]
            seen |= td["success"].squeeze(-1)
            total += td["reward"].squeeze(-1)
        env.close()
        success.append(seen.numpy())
        returns.append(total.numpy())
    return Reached(np.concatenate(success), np.concatenate(returns))


@app.command("success")
def success(
    weights: Annotated[Path, typer.Argument(help="Folder of door.npz, hammer.npz, ...")],
    episodes: Annotated[int, typer.Option(min=1)] = 1000,
) -> None:
    """Success of DAPG's published policies in these tasks."""
    rows = []
    for name in HANDS:
        path = weights / f"{name}.npz"
        if not path.is_file():
            raise typer.BadParameter(f"{path} does not exist: name the folder of the archives")
        reached = play(find_task(name), Weights(path), episodes)
        rows.append([name, f"{100 * reached.success.mean():.1f}", f"{reached.returns.mean():.0f}"])
    typer.echo(f"{episodes} episodes each, mean action, evaluation.seed={SEED}")
    typer.echo(tabulate(rows, ["task", "success %", "return"], tablefmt="github"))


class Raw:
    """``mj_step`` of one copy of a task's model, and nothing else."""

    units = float(CALL_STEPS)

    def __init__(self, task: str) -> None:
        env = find_task(task).make_env(EnvOptions(seed=0))
        assert isinstance(env, HandEnv)
        scene = env.simulator.scene
        self.model = copy.copy(scene.model)
        self.data = mujoco.MjData(self.model)
        size = (env.simulator.task.horizon, len(scene.control_middle))
        actions = np.random.default_rng(0).uniform(-1, 1, size)
        self.controls = scene.control_middle + scene.control_half_range * actions
        self.step = 0

    def call(self) -> None:
        """Some steps."""
        for _ in range(CALL_STEPS):
            at = self.step % len(self.controls)
            if at == 0:
                mujoco.mj_resetData(self.model, self.data)
            self.data.ctrl[:] = self.controls[at]
            mujoco.mj_step(self.model, self.data, SUBSTEPS)
            self.step += 1


@app.command("speed")
def speed(
    rounds: Annotated[int, typer.Option(min=1)] = 8,
    block_s: Annotated[float, typer.Option(help="Of each contestant in each round.")] = 2.0,
) -> None:
    """Steps per second: 64 copies on two threads, and the bare physics of one on one."""
    threads = min(2, available_cores())
    entries = []
    for task in HANDS:
        copies = {"count": COPIES, "threads": threads, "task": task}
        entries.append(Entry(f"{task}_copies", "benchmarks.environment:Doors", copies, threads))
        entries.append(Entry(f"{task}_raw", "benchmarks.hands:Raw", {"task": task}))
    timings = race(entries, rounds=rounds, block_s=block_s)
    medians = {
        name: spread([1.0 / seconds for seconds in timing.seconds_per_unit]).median
        for name, timing in timings.items()
    }
    rows = [
        [task, medians[f"{task}_raw"], medians[f"{task}_copies"],
         medians[f"{task}_copies"] / medians[f"{task}_raw"]]
        for task in HANDS
    ]  # fmt: skip
    headers = ["task", "mj_step, 1 thread", f"{COPIES} copies, {threads} threads", "ratio"]
    typer.echo(tabulate(rows, headers, tablefmt="github", floatfmt=("", ".0f", ".0f", ".2f")))


if __name__ == "__main__":
    app()
