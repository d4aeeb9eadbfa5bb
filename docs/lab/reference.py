"""DAPG's published policies in our tasks: ``python -m docs.lab.reference FOLDER``.

``FOLDER/TASK.npz`` holds the weights of aravindr93/hand_dapg's policy of a task as plain arrays
(``w0 b0 w1 b1 w2 b2``, ``in_shift in_scale out_shift out_scale``). Its mean action is judged on the
list of episodes on which ours are, and the figures are written to ``docs/results/tasks``, where the
table over tasks shows them below ours.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from envs import find_task
from envs.door import task as door
from envs.registry import OURS
from pipeline.files.run_files import as_json, versions, write_atomically
from pipeline.playing import make_evaluator
from pipeline.recipe import Recipe

FILE: Final = Path(__file__).parents[1] / "results" / "tasks" / "reference.json"
LAYERS: Final = 3
DOOR_OPEN_RAD: Final = 1.0
SMALLEST: Final = 1e-8
"""Added to the scale of an observation, as in DAPG's ``gaussian_mlp.py``."""


def _door_open(observation: Tensor) -> Tensor:
    """The door's 39th entry as DAPG and gymnasium-robotics have it, [N, 1]."""
    return torch.where(observation[:, [door.HINGE]] > DOOR_OPEN_RAD, 1.0, -1.0)


BEHIND: Final[Mapping[str, Callable[[Tensor], Tensor]]] = {"door": _door_open}
"""What DAPG observes behind our observations, by task."""


class Published(torch.nn.Module):
    """Mean action [N, A] of one of DAPG's policies, clipped to [-1, 1].

    Args:
        weights: Arrays of the file, float64.
        behind: Entries [N, E] that it observes behind ours; None for none.
    """

    def __init__(
        self, weights: Mapping[str, Any], behind: Callable[[Tensor], Tensor] | None = None
    ) -> None:
        super().__init__()
        self.told = {key: torch.as_tensor(value) for key, value in weights.items()}
        self.behind = behind

    def forward(self, observation: Tensor) -> Tensor:
        """Observations [N, O] of our task to actions [N, A]."""
        told, seen = self.told, observation.double()
        if self.behind is not None:
            seen = torch.cat([seen, self.behind(seen)], dim=-1)
        hidden = (seen - told["in_shift"]) / (told["in_scale"] + SMALLEST)
        for layer in range(LAYERS):
            hidden = hidden @ told[f"w{layer}"].T + told[f"b{layer}"]
            hidden = torch.tanh(hidden) if layer < LAYERS - 1 else hidden
        action = hidden * told["out_scale"] + told["out_shift"]
        return action.clamp(-1.0, 1.0).float()


def measure(folder: Path, task: str, reward: str) -> dict[str, Any]:
    """The figures of one policy at one reward."""
    recipe = Recipe().changed(task={"name": task}, env={"reward": reward, "num_threads": 1})
    found = recipe.find_task()
    with np.load(folder / f"{task}.npz") as weights:
        policy = Published(dict(weights), BEHIND.get(task))
    evaluator = make_evaluator(recipe, found, episodes=recipe.evaluation.episodes)
    acting = TensorDictModule(policy, ["observation"], ["action"])
    return evaluator.metrics(evaluator.run(acting))


def main(folder: Path, path: Path = FILE) -> None:
    """Measures every policy that is there, and writes the file."""
    found = {
        task: {reward: measure(folder, task, reward) for reward in find_task(task).rewards}
        for task in OURS
        if (folder / f"{task}.npz").is_file()
    }
    if not found:
        sys.exit(f"{folder} holds none of {', '.join(f'{task}.npz' for task in OURS)}")
    write_atomically(path, as_json({"versions": versions(), "tasks": found}, indent=1) + "\n")
    print(f"written to {path}")  # noqa: T201 - a command's output


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else sys.exit(f"usage: {__doc__}"))
