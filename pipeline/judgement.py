"""What is said of a clone before reinforcement learning begins with it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Final

from pipeline.data.demonstrations import Demonstrations
from pipeline.hooks import EvaluationHook
from pipeline.machine.random_state import kept_random_state
from pipeline.recipe import Recipe

_logger = logging.getLogger(__name__)

POOR: Final = 0.5
"""Share of the demonstrations' success below which a clone is called poor."""
REMEDIES: Final[Mapping[str, str]] = {
    "nll": "loss.imitation=fixed_width",
    "mse": "loss.imitation=fixed_width",
    "fixed_width": "loss.imitation=nll",
}
"""The error to try instead, by the one in use."""


def poor_clone(figures: Mapping[str, Any], shown: float | None, recipe: Recipe) -> str | None:
    """One line on a clone that fails where its demonstrations succeed; None of any other.

    Args:
        figures: of the clone's evaluation (:class:`pipeline.act.metrics.EpisodeMetrics`).
        shown: share of the demonstrations that succeed; None if nobody knows, and then a clone
            is compared with such as do: people keep the episodes that worked.
        recipe: of the run, for the remedies.
    """
    success = figures.get("success_once")
    expected = 1.0 if shown is None else shown
    # An interval wholly below the bound: a few unlucky episodes do not make a clone poor.
    if success is None or figures["success_once_ci95"][1] >= POOR * expected:
        return None
    theirs = (
        "its demonstrations tell no success"
        if shown is None
        else (f"{shown:.0%} of its demonstrations do")
    )
    return (
        f"a poor clone to begin with: {success:.0%} of {figures['episodes']} episodes succeed, "
        f"{theirs}; reinforcement learning may never see a success. Try "
        f"{REMEDIES[recipe.loss.imitation]}, more demonstrations, another bc.updates (now "
        f"{recipe.bc.updates}), or look for what they show that the observation does not"
    )


def check_clone(evaluation: EvaluationHook, recipe: Recipe, demos: Demonstrations | None) -> None:
    """Evaluates the clone, in the learning curve's row of 0 frames, and warns of a poor one.

    Nothing is evaluated where the run is not to be (``evaluation.interval=0``).
    """
    if evaluation.interval == 0:
        return
    with kept_random_state(recipe.device):
        figures = evaluation.begin()
    shown = None if demos is None else demos.success_share
    found = poor_clone(figures, shown, recipe)
    if found is not None:
        _logger.warning("%s", found)
