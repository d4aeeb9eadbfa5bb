"""A loss and a stepper with everything the pipeline's can have, and what they learn from batches.

For tests in which updates made in another way must be the ordinary ones.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor

from losses import BCSACLoss, LinearWeight
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, make_batch

UPDATES = 20
MAIN_ROWS, DEMO_ROWS = 8, 4


def make_loss(device: str = "cpu", **options) -> BCSACLoss:
    hidden = {"hidden_dtype": options.pop("hidden_dtype", None)}
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [16, 16], **hidden)
    critic = BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [16, 16], 3, layer_norm=True, **hidden)
    return BCSACLoss(
        actor.to(device),
        critic.to(device),
        target_entropy=-float(ACTION_SIZE),
        main_rows=MAIN_ROWS,
        # Another weight at each update: what is compiled or recorded must not keep that of its own.
        bc_weight=LinearWeight(init=1.0, final=0.2, duration=UPDATES),
        **options,
    )


def make_stepper(loss: BCSACLoss, *, target_period: int = 2, **options) -> BCSACStepper:
    return BCSACStepper(
        loss,
        actor_lr=1e-3,
        critic_lr=2e-3,
        temperature_lr=3e-3,
        schedule=UpdateSchedule(target_period=target_period, diagnostics_period=3, actor_delay=2),
        anneal_updates=UPDATES,
        **options,
    )


def marked(count: int) -> list[TensorDict]:
    """Batches that say which rows are demonstrations."""
    return [make_batch(MAIN_ROWS + DEMO_ROWS, DEMO_ROWS) for _ in range(count)]


def marked_and_unmarked(count: int) -> list[TensorDict]:
    """The same, and every fifth one without marks and of another size (DA-SAC)."""
    return [make_batch(5, None) if i % 5 == 4 else marked(1)[0] for i in range(count)]


def learnt(loss: BCSACLoss, stepper, given: list[TensorDict]) -> tuple[dict, list[dict], Tensor]:
    """Weights, results of the steps and the next random number."""
    torch.manual_seed(3)
    found = [stepper.step(None, batch.clone()).to_dict() for batch in given]
    weights = {name: value.clone() for name, value in loss.named_parameters()}
    return weights, found, torch.rand(1)
