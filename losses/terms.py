"""What the two networks of BC-SAC are trained on, with its ingredients for logs and balancing."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class CriticTerms:
    """The critic loss and what it was made of; R rows took part.

    Attributes:
        loss: ``[]``, the error summed over critics, mean over the R rows.
        q: ``[E, R, 1]``, values of the batch's own actions, detached.
        target: ``[R, 1]``, the soft TD target.
    """

    loss: Tensor
    q: Tensor
    target: Tensor


@dataclass(frozen=True)
class ActorTerms:
    """The two halves of the BC-SAC actor objective, from one forward pass of the actor.

    The objective (section III-C) is minimised as ``rl + weight * bc``. The halves come apart so
    that their gradients can be taken, logged and balanced one by one; the graph of the forward
    pass is shared, so the first of two such calls needs ``retain_graph=True``.

    Attributes:
        rl: ``[]``, mean of alpha log pi - Q over the R reinforcement rows.
        bc: ``[]``, mean imitation error over the demonstration rows, not times lambda. Where none
            is marked it is 0 with zero gradient; where the batch has no marks, a constant 0.
        log_prob: ``[R]``, log-density in nats of the sampled actions, detached.
        q: ``[R, 1]``, the critics' value of the sampled actions, detached.
    """

    rl: Tensor
    bc: Tensor
    log_prob: Tensor
    q: Tensor
