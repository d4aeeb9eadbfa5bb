"""Errors of a policy on demonstrated actions, as pure functions of tensors: ``[B]``, one a row.

Notation as in :mod:`losses.functional`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from torch import Tensor
from torchrl.modules import TanhNormal

ImitationError = Callable[[TanhNormal, Tensor], Tensor]

IMITATION_STD: Final = 0.2
"""Standard deviation of the normal in :func:`fixed_width_nll`, in units of the action."""


def clamp_to_support(action: Tensor, margin: float) -> Tensor:
    """Move actions at or beyond the edges of (-1, 1) inside, to where a tanh density is usable.

    The pre-tanh value atanh(a) of a recorded action grows without bound towards the edge, and the
    likelihood with its square: for a policy of scale 0.3 and 28 saturated dimensions the negative
    log-likelihood is 7,796 nats at a margin of 1e-6 (float32's own limit), 2,064 at 1e-3 and 972
    at 1e-2. 5.6 % of the human actions lie outside [-1, 1].

    Args:
        action: any shape, nominally in [-1, 1].
        margin: distance kept from the edges, in (0, 1).

    Returns:
        The same shape, in [-1 + margin, 1 - margin].
    """
    return action.clamp(-1.0 + margin, 1.0 - margin)


def negative_log_likelihood(policy: TanhNormal, action: Tensor) -> Tensor:
    """Imitation error of section III-B, ``-log pi(a|s)`` in nats.

    Args:
        policy: a distribution with ``B`` rows over ``A`` dimensions.
        action: ``[B, A]`` inside the policy's support (see :func:`clamp_to_support`).

    Returns:
        ``[B]``; of a density, so it may be negative.
    """
    return -policy.log_prob(action)


def mean_action_error(policy: TanhNormal, action: Tensor) -> Tensor:
    """Squared distance between the policy's deterministic action and ``action``.

    Averaged over the ``A`` dimensions. It does not train the policy's scale.

    Args:
        policy: a distribution with ``B`` rows over ``A`` dimensions.
        action: ``[B, A]``.

    Returns:
        ``[B]``, in squared units of the action.
    """
    return (policy.deterministic_sample - action).square().mean(-1)


def fixed_width_nll(policy: TanhNormal, action: Tensor) -> Tensor:
    r"""Negative log-likelihood in nats under a normal of fixed width around the policy's action.

    .. math::
        -\sum_i \log N(a_i;\, \tanh \mu_i, 0.2) =
        \sum_i \frac{(a_i - \tanh \mu_i)^2}{2 \cdot 0.2^2} + A \log(0.2 \sqrt{2 \pi})

    It is a regression on the bounded action, so it is finite and smooth where demonstrated actions
    are at their bounds. It has the unit and about the size of :func:`negative_log_likelihood`, so
    that the same lambda suits both. It does not train the policy's scale.

    Args:
        policy: a distribution with ``B`` rows over ``A`` dimensions.
        action: ``[B, A]`` in [-1, 1].

    Returns:
        ``[B]``; of a density, so it may be negative.
    """
    squares = (policy.deterministic_sample - action).square().sum(-1)
    constant = action.shape[-1] * math.log(IMITATION_STD * math.sqrt(2.0 * math.pi))
    return squares / (2.0 * IMITATION_STD**2) + constant


IMITATION_ERRORS: Mapping[str, ImitationError] = {
    "nll": negative_log_likelihood,
    "mse": mean_action_error,
    "fixed_width": fixed_width_nll,
}
"""The imitation errors by the name that a configuration gives them."""
