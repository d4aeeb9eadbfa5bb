"""Floating point operations of an update, by formula.

Only the matrix products of dense layers are counted: element-wise work is what an implementation
should make small, not what it should be credited for. The count is of the *algorithm*, the same
for every implementation: one that computes more (say, gradients that nobody uses) gets no credit.

A product of [m, k] and [k, n] is ``2 m k n`` operations. For a network with weights ``W``, of which
``W_1`` in the first layer, on ``R`` rows:

    forward                      2 R W
    gradient of the weights      2 R W
    gradient of the inputs       2 R W, or 2 R (W - W_1) if the network's own input needs none
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from envs.door.task import ACTION_SIZE, OBSERVATION_SIZE


@dataclass(frozen=True)
class Dense:
    """Sizes of a stack of dense layers, input and output included."""

    sizes: Sequence[int]

    @property
    def weights(self) -> int:
        """Entries of all weight matrices."""
        return sum(a * b for a, b in pairwise(self.sizes))

    @property
    def first(self) -> int:
        """Entries of the first layer's weight matrix."""
        return self.sizes[0] * self.sizes[1]

    def forward(self, rows: int) -> int:
        """Operations of a forward pass."""
        return 2 * rows * self.weights

    def weight_gradient(self, rows: int) -> int:
        """Operations of the gradient of the weights, with the input gradients that it needs."""
        return 2 * rows * self.weights + 2 * rows * (self.weights - self.first)

    def input_gradient(self, rows: int) -> int:
        """Operations of the gradient of the network's input alone."""
        return 2 * rows * self.weights


def update_flops(
    width: int,
    batch: int,
    *,
    demo_rows: int = 0,
    num_critics: int = 2,
    observation: int = OBSERVATION_SIZE,
    action: int = ACTION_SIZE,
) -> int:
    """Operations of one critic, actor and temperature update with two hidden layers.

    Args:
        width: Of the hidden layers.
        batch: Rows of the reinforcement terms.
        demo_rows: Further rows that only the imitation term sees.
        num_critics: Size of the ensemble, all of it in the target.
        observation: Size of an observation.
        action: Size of an action.
    """
    actor = Dense((observation, width, width, 2 * action))
    critic = Dense((observation + action, width, width, 1))
    target = actor.forward(batch) + num_critics * critic.forward(batch)
    critic_step = num_critics * (critic.forward(batch) + critic.weight_gradient(batch))
    value_of_policy = num_critics * (critic.forward(batch) + critic.input_gradient(batch))
    rows = batch + demo_rows
    actor_step = actor.forward(rows) + actor.weight_gradient(rows)
    return target + critic_step + value_of_policy + actor_step
