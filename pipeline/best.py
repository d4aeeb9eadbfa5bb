"""The weights of a run's best evaluation, kept beside its checkpoints, which hold the newest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from tensordict.nn import TensorDictModuleBase

from pipeline.files import again
from pipeline.files.curves import FRAMES, read_lines
from pipeline.files.run_files import LEARNING_CURVE
from pipeline.files.simulator_steps import ExtraSimulatorSteps
from pipeline.policy import WEIGHTS, save_weights
from pipeline.recipe import Recipe
from pipeline.run_dir import save_recipe
from pipeline.watch.phases import outcome

BEST: Final = "best"
"""Folder of a run directory; every command that takes a run takes it, too."""


def rank(figures: Mapping[str, Any]) -> tuple[float, float]:
    """By what evaluations are compared: success, then return; the greater is the better."""
    return (figures.get("success_once") or 0.0, figures.get("return_mean", -math.inf))


class BestWeights:
    """Keeps the weights of a policy as an exported policy whenever an evaluation beats all before.

    The evaluations of a run are few episodes of the list that ``make eval`` plays more of, and the
    best of many is better by luck, too: a figure to report is that of other episodes. A run that
    goes on from a checkpoint before its best evaluation comes by that one again.

    Args:
        recipe: Of the run; saved beside the weights.
        policy: As it is evaluated.
        run_dir: Of the run.
    """

    def __init__(self, recipe: Recipe, policy: TensorDictModuleBase, run_dir: Path) -> None:
        self.recipe = recipe
        self.policy = policy
        self.run_dir = run_dir
        self.folder = run_dir / BEST

    def offer(
        self, frames: int, figures: Mapping[str, Any], before: Sequence[Mapping[str, Any]]
    ) -> None:
        """Keeps the present weights if ``figures`` are better than those of all rows ``before``.

        Raises:
            OSError: If they cannot be written; what was kept before stays.
        """
        if before and rank(figures) <= max(rank(row) for row in before):
            return
        self.folder.mkdir(exist_ok=True)
        save_weights(self.policy, self.folder / WEIGHTS, frames=self.recipe.budget.frames(frames))
        save_recipe(self.folder, self.recipe)
        beside = ExtraSimulatorSteps.read(self.run_dir)
        if beside is not None:
            beside.write(self.folder)


def better_before(run_dir: Path) -> str:
    """A line on the best evaluation of a run, if its last one is not as good and it was kept."""
    rows, folder = read_lines(run_dir / LEARNING_CURVE), run_dir / BEST
    if not rows or not folder.is_dir():
        return ""
    best = max(rows, key=rank)  # the first of those that are as good
    if rank(rows[-1]) == rank(best):
        return ""
    found = f"its best evaluation was {outcome(best)}, after {best[FRAMES]:,}"
    return f"{found}; of these weights: {again.evaluate(folder)}"
