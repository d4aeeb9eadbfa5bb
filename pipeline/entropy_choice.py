"""Which entropy suits a policy that begins as a clone: ``loss.target_entropy=clone``."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.modules import ProbabilisticActor

from pipeline.data.demonstrations import Demonstrations
from pipeline.machine.random_state import kept_random_state
from pipeline.recipe import Recipe

_logger = logging.getLogger(__name__)

CLONE: Final = "clone"
OPEN: Final = {"loss.target_entropy": CLONE}
"""The key that is chosen here, and the value that leaves it open."""
BELOW: Final = 0.2
"""How far below the clone's own entropy the target is, in nats an action entry.

What the door was found to need (envs/door/defaults.py): its clone has -40 nats over 28 entries, and
-45 let it stay where it had begun.
"""
ROWS: Final = 10_000
"""Demonstrated states that the entropy is measured in; one draw each is plenty."""


def with_chosen_entropy(
    recipe: Recipe, clone: Callable[[], ProbabilisticActor], demos: Demonstrations | None
) -> Recipe:
    """The recipe with the number that ``clone`` stands for; any other is as it was.

    SAC's temperature widens a policy until its entropy is the target. Minus the number of action
    entries, the usual target, is that of a policy which learns from nothing; one that repeats what
    it was shown is narrower, and much narrower where the actions stand at their bounds. It would be
    widened until it fails.

    Deviation: the paper aims at minus the number of action entries (its base implementation).
    Undo: ``loss.target_entropy=null``.

    Args:
        recipe: of the run.
        clone: gives the model that the policy begins as.
        demos: the run's demonstrations.
    """
    if recipe.loss.target_entropy != CLONE:
        return recipe
    if demos is None or recipe.offline or not recipe.pretrain:
        return recipe.changed(loss={"target_entropy": None})  # nothing begins as a clone
    with kept_random_state(recipe.device):
        torch.manual_seed(recipe.seed)
        entropy, entries = mean_entropy(clone(), spread(demos.rows))
    target = round(entropy - BELOW * entries, 1)
    _logger.info(
        "loss.target_entropy=%s: the clone has %.1f nats in the demonstrated states",
        target, entropy,
    )  # fmt: skip
    return recipe.changed(loss={"target_entropy": target})


def spread(rows: TensorDictBase) -> TensorDictBase:
    """At most :data:`ROWS` of the rows [R], at even distances.

    Rows lie in the order of their episodes: the first of a large set are of a few episodes only.
    """
    count = len(rows)
    return rows if count <= ROWS else rows[torch.arange(ROWS) * count // ROWS]


@torch.no_grad()
def mean_entropy(actor: ProbabilisticActor, rows: TensorDictBase) -> tuple[float, int]:
    """Entropy of the policy in nats, its mean over the rows, and the entries of an action.

    Args:
        actor: policy.
        rows: [R] with ``observation`` [R, O].
    """
    seen = TensorDict({"observation": rows["observation"]}, rows.batch_size)
    actions, log_prob = actor.get_dist(seen).rsample_and_log_prob()
    return -float(log_prob.mean()), actions.shape[-1]
