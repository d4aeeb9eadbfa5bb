"""Which imitation error suits the demonstrations: ``loss.imitation=auto``."""

from __future__ import annotations

import logging
from typing import Final

from pipeline.data.demonstrations import Demonstrations
from pipeline.recipe import Recipe

_logger = logging.getLogger(__name__)

AUTO: Final = "auto"
OPEN: Final = {"loss.imitation": AUTO}
"""The key that is chosen here, and the value that leaves it open."""
MANY_SATURATED: Final = 0.1
"""Share of demonstrated action entries at their bounds above which no likelihood is maximised.

The human demonstrations of the door, which a likelihood suits, hold 6 %; a controller that moves as
fast as it may and opens or closes a gripper, a third.
"""

TOLD: Final = {
    "fixed_width": (
        "demonstrated actions are imitated by their distance: %.0f %% of their entries are at the "
        "bounds, which a likelihood does not suit (all the same: loss.imitation=nll)"
    ),
    "nll": (
        "demonstrated actions are imitated by their likelihood: only %.0f %% of their entries are "
        "at the bounds (by their distance: loss.imitation=fixed_width)"
    ),
}


def with_chosen_imitation(recipe: Recipe, demos: Demonstrations | None) -> Recipe:
    """The recipe with the error that ``auto`` stands for; any other is as it was.

    A squashed Gaussian has no finite likelihood of an action at its bounds: its mean is pulled out
    to where tanh is flat, and its scale is spent on the distance. Where many entries are there, the
    bounded action is regressed instead, whose error is as small there as elsewhere.

    Deviation: the paper maximises the likelihood whatever the demonstrations hold. Undo:
    ``loss.imitation=nll``.

    Args:
        recipe: of the run.
        demos: its demonstrations; without any, nothing is imitated and the paper's error stands.
    """
    if recipe.loss.imitation != AUTO:
        return recipe
    if demos is None:
        return recipe.changed(loss={"imitation": "nll"})
    share = demos.saturated_share
    chosen = "fixed_width" if share > MANY_SATURATED else "nll"
    _logger.info(TOLD[chosen], 100 * share)
    return recipe.changed(loss={"imitation": chosen})
