"""The arithmetic of BC-SAC as pure functions of tensors.

The functions take and return tensors, and use no module. They draw no random numbers, except for
:func:`subset_minimum` and :func:`draw_members`, which take a generator. They **do not reduce over
rows** but return one value per transition, ``[B]`` or ``[B, 1]``: the caller, a term, decides which
rows take part and what the denominator of their mean is (:func:`masked_mean` helps with it).

Notation: ``B`` transitions, ``A`` action dimensions, ``E`` critics. A *column* is a ``[B, 1]``
tensor, as TorchRL stores rewards and terminations. Equations are those of the paper, "Augmenting
Reinforcement Learning Policies using Human Samples".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import torch
from torch import Tensor
from torchrl.objectives.utils import distance_loss

CriticDistance = Literal["l2", "l1", "smooth_l1"]


def soft_td_target(
    reward: Tensor,
    terminated: Tensor,
    next_q: Tensor,
    *,
    gamma: float,
    steps: Tensor | None = None,
    next_log_prob: Tensor | None = None,
    temperature: Tensor | None = None,
) -> Tensor:
    r"""The value a critic is regressed on (section III-A, the equation of Q-hat).

    .. math::
        \hat Q = r + \gamma^n (1 - d) \left[ Q(s', a') - \alpha \log \pi(a' | s') \right],
        \quad a' \sim \pi(\cdot | s')

    Only a *termination* ends the return. After a time limit the episode could have gone on, so a
    truncated transition bootstraps like any other.

    Args:
        reward: ``[B, 1]``; for n-step transitions the discounted sum of the n rewards.
        terminated: ``[B, 1]`` bool, whether the environment's own end was reached.
        next_q: ``[B, 1]``, the target critics' value Q' of the next state and the policy's action
            there.
        gamma: discount per environment step, in [0, 1].
        steps: ``[B, 1]`` environment steps n between the two states; ``None`` means 1 for all.
        next_log_prob: ``[B]``, log-density in nats of the policy's action in the next state;
            ``None`` leaves the entropy bonus out, as RLPD does on the Adroit tasks
            (arXiv:2302.02948).
        temperature: ``[]``, the entropy weight alpha, required with ``next_log_prob``. The paper
            writes it as 1.

    Returns:
        ``[B, 1]``.

    Raises:
        ValueError: if a shape is not as stated, or ``next_log_prob`` comes without a temperature.
    """
    _require_columns(reward=reward, terminated=terminated, next_q=next_q)
    next_value = next_q
    if next_log_prob is not None:
        _require_rows(len(reward), next_log_prob=next_log_prob)
        if temperature is None:
            raise ValueError(
                "the entropy bonus of next_log_prob needs its weight: give temperature"
            )
        next_value = next_q - temperature * next_log_prob.unsqueeze(-1)
    # Filled rather than multiplied by zero: what follows a termination may be anything, NaN too.
    next_value = next_value.masked_fill(terminated, 0.0)
    if steps is None:
        return reward + gamma * next_value
    _require_columns(reward=reward, steps=steps)
    return reward + gamma ** steps.to(next_value.dtype) * next_value


def positive_advantage(returns: Tensor, value: Tensor, cap: float | None = None) -> Tensor:
    r"""How much better an episode was than the policy's value: ``max(R - V(s), 0)``.

    Source: arXiv:1806.05635, section 3, the equation of the self-imitation loss.

    Args:
        returns: ``[B]``, discounted returns R of the episodes, from the rows' states to their ends.
        value: ``[B]``, values V of these states.
        cap: larger advantages are reduced to this; ``None`` for no limit.

    Returns:
        ``[B]``, >= 0.

    Raises:
        ValueError: if a shape is not as stated.
    """
    _require_rows(len(returns), returns=returns, value=value)
    return (returns - value).clamp(min=0.0, max=cap)


def critic_error(q: Tensor, target: Tensor, distance: CriticDistance = "l2") -> Tensor:
    r"""Regression error of the critics (section III-A), **summed** over the E critics.

    .. math:: \sum_e (Q_e(s, a) - \hat Q)^2

    As in pytorch_sac and TorchRL's ``SACLoss``, there is no factor 1/2 and no division by E: each
    critic gets the gradient that it would get alone.

    Args:
        q: ``[E, B, 1]``.
        target: ``[B, 1]``, without gradient.
        distance: ``l2`` (the paper), ``l1`` or ``smooth_l1`` (TorchRL's default).

    Returns:
        ``[B]``.

    Raises:
        ValueError: if a shape is not as stated.
    """
    _require_ensemble(q)
    _require_columns(q_of_one_critic=q[0], target=target)
    return distance_loss(q, target.expand_as(q), distance).sum(0).squeeze(-1)


def actor_objective(log_prob: Tensor, q: Tensor, temperature: Tensor) -> Tensor:
    r"""What the actor minimises (section III-A): ``alpha log pi(a|s) - Q(s, a)``, ``a ~ pi``.

    Args:
        log_prob: ``[B]``, log-density in nats of a reparametrised action.
        q: ``[B, 1]``, the critics' value of it.
        temperature: ``[]``, the entropy weight alpha.

    Returns:
        ``[B]``.

    Raises:
        ValueError: if a shape is not as stated.
    """
    _require_columns(q=q)
    _require_rows(len(q), log_prob=log_prob)
    return temperature * log_prob - q.squeeze(-1)


def temperature_objective(
    log_prob: Tensor, log_temperature: Tensor, target_entropy: float
) -> Tensor:
    r"""What the temperature minimises: ``-log(alpha) (log pi(a|s) + H)``, ``a ~ pi``.

    The gradient vanishes where the policy's mean entropy is the target H (arXiv:1812.05905, eq. 18,
    with log alpha as in TorchRL; pytorch_sac has alpha in its place, which multiplies the gradient
    by alpha and keeps its sign).

    Args:
        log_prob: ``[B]`` in nats; detached here, so that no gradient reaches the actor.
        log_temperature: ``[]``.
        target_entropy: H in nats.

    Returns:
        ``[B]``.

    Raises:
        ValueError: if ``log_prob`` is not ``[B]``.
    """
    _require_rows(len(log_prob), log_prob=log_prob)
    return -log_temperature * (log_prob.detach() + target_entropy)


def subset_minimum(
    q: Tensor, size: int | None = None, generator: torch.Generator | None = None
) -> Tensor:
    """Minimum over ``size`` critics drawn without replacement, the same for all rows (REDQ).

    Args:
        q: ``[E, B, 1]``.
        size: number of critics to draw, 1 to E; ``None`` or E takes all without a draw.
        generator: for the draw, on ``q``'s device; ``None`` is torch's global one.

    Returns:
        ``[B, 1]``; the more critics, the lower and more pessimistic.

    Raises:
        ValueError: if ``q`` is not ``[E, B, 1]`` or ``size`` is not in 1 to E.
    """
    _require_ensemble(q)
    members = draw_members(len(q), size, q.device, generator)
    return (q if members is None else q[members]).min(0).values


def draw_members(
    ensemble: int,
    size: int | None,
    device: torch.device | str = "cpu",
    generator: torch.Generator | None = None,
) -> Tensor | None:
    """Draw the indices ``[size]`` of the critics for a subset minimum; ``None`` means all of them.

    With the draw made before the critics run, only those that take part need to run.

    Raises:
        ValueError: if ``size`` is not in 1 to ``ensemble``.
    """
    if size is not None and not 1 <= size <= ensemble:
        raise ValueError(f"the subset minimum needs 1 to {ensemble} critics, not {size}")
    if size is None or size == ensemble:
        return None
    # Not randperm with its generator, which TorchInductor cannot call from C++.
    return torch.rand(ensemble, generator=generator, device=device).topk(size).indices


def ensemble_mean(q: Tensor) -> Tensor:
    """Mean over the critics: less pessimistic than the minimum (RLPD's choice for the actor).

    Args:
        q: ``[E, B, 1]``.

    Returns:
        ``[B, 1]``.

    Raises:
        ValueError: if ``q`` is not ``[E, B, 1]``.
    """
    _require_ensemble(q)
    return q.mean(0)


ENSEMBLE_VALUES: Mapping[str, Callable[[Tensor], Tensor]] = {
    "min": subset_minimum,
    "mean": ensemble_mean,
}
"""Ways to make one value ``[B, 1]`` of E critics' ``[E, B, 1]``, by name in a configuration."""


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of ``values`` over the rows that ``mask`` marks; 0 with zero gradient if there are none.

    No shape depends on the data, so the host of an accelerator does not have to wait for a count.

    Args:
        values: ``[B]``; those of unmarked rows may be anything, NaN too.
        mask: ``[B]`` bool.

    Returns:
        ``[]``; the denominator is the number of marked rows, not B.

    Raises:
        ValueError: if either is not ``[B]``.
    """
    _require_rows(len(values), values=values, mask=mask)
    return values.masked_fill(mask.logical_not(), 0.0).sum() / mask.sum().clamp(min=1)


def _require_columns(**tensors: Tensor) -> None:
    """Raise ``ValueError`` unless all are ``[B, 1]`` with one B: broadcasting would hide it."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    rows = next(iter(shapes.values()))[:1]
    if any(shape != (*rows, 1) for shape in shapes.values()):
        raise ValueError(f"expected tensors of one shape [B, 1], got {shapes}")


def _require_rows(rows: int, **tensors: Tensor) -> None:
    """Raise ``ValueError`` unless all are ``[rows]``."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if any(shape != (rows,) for shape in shapes.values()):
        raise ValueError(f"expected tensors of shape [B] = [{rows}], got {shapes}")


def _require_ensemble(q: Tensor) -> None:
    """Raise ``ValueError`` unless ``q`` is ``[E, B, 1]``."""
    if q.ndim != 3 or q.shape[-1] != 1:
        raise ValueError(f"expected critic values of shape [E, B, 1], got {tuple(q.shape)}")
