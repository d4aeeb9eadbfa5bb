"""Which factor suits the rewards of an unknown task: ``loss.reward_scale=auto``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Final

import torch
from torchrl.objectives.value.functional import reward2go

from envs.demonstrations.episode import Episode
from pipeline.data.demonstrations import Demonstrations
from pipeline.recipe import Recipe

_logger = logging.getLogger(__name__)

AUTO: Final = "auto"
OPEN: Final = {"loss.reward_scale": AUTO}
"""The key that is chosen here, and the value that leaves it open."""
VALUE: Final = 30.0
"""What a good demonstrated state is worth to the critics.

On Hopper, whose demonstrations are worth 270, BC-SAC fell below its clone with rewards as they are
and stayed above it with a tenth (docs/lab/notes/34-reward-scale.md).
"""
GOOD: Final = 0.9
"""Quantile of the demonstrated states' values that counts as good."""


def unscaled(recipe: Recipe) -> Recipe:
    """The recipe for rows of which the factor is to be chosen; with a number it is as it was."""
    open_yet = recipe.loss.reward_scale == AUTO
    return recipe.changed(loss={"reward_scale": 1.0}) if open_yet else recipe


def with_chosen_scale(
    recipe: Recipe, demos: Demonstrations | None
) -> tuple[Recipe, Demonstrations | None]:
    """The recipe with the number that ``auto`` stands for, and the demonstrations' rows with it.

    Imitation is measured in nats, reinforcement in the task's rewards: with a hundred times the
    reward, the same lambda means a hundredth of the imitation. Rewards are scaled down until a good
    demonstrated state is worth :data:`VALUE`. They are never scaled up: little reward leaves the
    actor close to the demonstrations, which is the safe side.

    Deviation: the paper takes rewards as they are. Undo: ``loss.reward_scale=1``.

    Args:
        recipe: of the run; with a number, both come back as they were.
        demos: its demonstrations, made with the :func:`unscaled` recipe; without any there is
            nothing to be out of proportion with.
    """
    if recipe.loss.reward_scale != AUTO:
        return recipe, demos
    if demos is None:
        return unscaled(recipe), demos
    worth = good_value(demos.episodes, recipe.loss.gamma)
    scale = 1.0 if worth <= VALUE else float(f"{VALUE / worth:.2g}")
    _logger.info("%s", _told(scale, worth, recipe.loss.gamma))
    return recipe.changed(loss={"reward_scale": scale}), demos.rewarded(scale)


def _told(scale: float, worth: float, gamma: float) -> str:
    sums = (
        f"from a good demonstrated state on they add up to {worth:.3g}, discounted by "
        f"loss.gamma={gamma:g}"
    )
    if scale == 1.0:
        return (
            f"rewards are used as they are: {sums}, and beyond {VALUE:g} imitation would count too "
            "little beside them (another factor: loss.reward_scale=NUMBER)"
        )
    return (
        f"rewards are multiplied by {scale:g}, or imitation would count too little beside them: "
        f"{sums} (as they are: loss.reward_scale=1)"
    )


def good_value(episodes: Sequence[Episode], gamma: float) -> float:
    """The :data:`GOOD` quantile of the absolute discounted rewards to go, over all steps.

    Args:
        episodes: at least one, of any lengths.
        gamma: discount per step; what follows the recording counts as nothing.
    """
    worths = []
    for episode in episodes:
        reward = torch.as_tensor(episode.rewards, dtype=torch.float64).unsqueeze(-1)
        done = torch.zeros_like(reward, dtype=torch.bool)
        done[-1] = True
        worths.append(reward2go(reward, done, gamma).abs().flatten())
    return float(torch.cat(worths).quantile(GOOD))
