"""Values and gradients worked out by hand, and the invariants of the pure functions."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from losses import functional as F


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values).unsqueeze(-1)


# ------------------------------------------------------------------------------- soft TD target

# One transition: r = 1, Q' = 4, log pi' = 2, alpha = 1/4, so the soft value is 4 - 1/2 = 3.5.
TD_TABLE = [
    # terminated, gamma, steps, with entropy, target
    (False, 0.5, None, True, 1 + 0.5 * 3.5),
    (True, 0.5, None, True, 1.0),
    (False, 0.5, None, False, 1 + 0.5 * 4.0),
    (False, 0.5, 3, True, 1 + 0.125 * 3.5),
    (False, 0.5, 3, False, 1 + 0.125 * 4.0),
    (True, 0.5, 3, True, 1.0),
    (False, 0.0, None, True, 1.0),
    (False, 1.0, 7, True, 4.5),
]


@pytest.mark.parametrize(("terminated", "gamma", "steps", "entropy", "expected"), TD_TABLE)
def test_soft_td_target_by_hand(
    terminated: bool, gamma: float, steps: int | None, entropy: bool, expected: float
) -> None:
    target = F.soft_td_target(
        reward=column(1.0),
        terminated=torch.tensor([[terminated]]),
        next_q=column(4.0),
        gamma=gamma,
        steps=None if steps is None else torch.tensor([[steps]]),
        next_log_prob=torch.tensor([2.0]) if entropy else None,
        temperature=torch.tensor(0.25),
    )
    torch.testing.assert_close(target, column(expected))


def test_soft_td_target_uses_each_row_s_own_steps() -> None:
    target = F.soft_td_target(
        reward=column(0.0, 0.0),
        terminated=torch.zeros(2, 1, dtype=torch.bool),
        next_q=column(1.0, 1.0),
        next_log_prob=torch.zeros(2),
        temperature=torch.tensor(0.1),
        gamma=0.5,
        steps=torch.tensor([[1], [4]]),
    )
    torch.testing.assert_close(target, column(0.5, 0.0625))


def test_soft_td_target_ignores_whatever_follows_a_termination() -> None:
    target = F.soft_td_target(
        reward=column(1.0),
        terminated=torch.tensor([[True]]),
        next_q=column(math.nan),
        next_log_prob=torch.tensor([math.inf]),
        temperature=torch.tensor(0.1),
        gamma=0.9,
    )
    torch.testing.assert_close(target, column(1.0))


# ---------------------------------------------------------------------------------- objectives


def test_critic_error_sums_over_critics_and_keeps_rows_apart() -> None:
    # Row 0: (1 - 2)^2 + (5 - 2)^2 = 10; row 1: (0 - 0)^2 + (2 - 0)^2 = 4. Gradient 2 (q - target).
    q = torch.tensor([[[1.0], [0.0]], [[5.0], [2.0]]], requires_grad=True)
    error = F.critic_error(q, column(2.0, 0.0))
    torch.testing.assert_close(error, torch.tensor([10.0, 4.0]))
    (gradient,) = torch.autograd.grad(error.sum(), q)
    torch.testing.assert_close(gradient, torch.tensor([[[-2.0], [0.0]], [[6.0], [4.0]]]))


@pytest.mark.parametrize(("distance", "expected"), [("l2", 9.0), ("l1", 3.0), ("smooth_l1", 2.5)])
def test_critic_error_distances(distance: F.CriticDistance, expected: float) -> None:
    error = F.critic_error(torch.tensor([[[3.0]]]), column(0.0), distance)
    torch.testing.assert_close(error, torch.tensor([expected]))


def test_actor_objective_by_hand() -> None:
    log_prob = torch.tensor([2.0, -4.0], requires_grad=True)
    q = column(1.0, 3.0).requires_grad_()
    objective = F.actor_objective(log_prob, q, torch.tensor(0.5))
    torch.testing.assert_close(objective, torch.tensor([0.0, -5.0]))
    by_log_prob, by_q = torch.autograd.grad(objective.sum(), (log_prob, q))
    torch.testing.assert_close(by_log_prob, torch.tensor([0.5, 0.5]))
    torch.testing.assert_close(by_q, column(-1.0, -1.0))


def test_temperature_objective_by_hand() -> None:
    # log pi + H = 10 - 28 = -18: the policy is *more* random than asked, so alpha must fall:
    # the gradient on log alpha is +18.
    log_prob = torch.tensor([10.0], requires_grad=True)
    log_temperature = torch.tensor(-2.0, requires_grad=True)
    objective = F.temperature_objective(log_prob, log_temperature, -28.0)
    torch.testing.assert_close(objective, torch.tensor([-36.0]))
    by_temperature, by_log_prob = torch.autograd.grad(
        objective.sum(), (log_temperature, log_prob), allow_unused=True
    )
    torch.testing.assert_close(by_temperature, torch.tensor(18.0))
    assert by_log_prob is None


# -------------------------------------------------------------------------------- the ensemble


def ranked_critics(ensemble: int, rows: int = 3) -> torch.Tensor:
    """Critic e says e for every row, so a minimum names the lowest critic that took part."""
    return torch.arange(float(ensemble)).view(-1, 1, 1).expand(ensemble, rows, 1)


@given(ensemble=st.integers(1, 10), data=st.data())
def test_subset_minimum_is_of_distinct_critics_shared_by_all_rows(
    ensemble: int, data: st.DataObject
) -> None:
    size = data.draw(st.integers(1, ensemble))
    seed = data.draw(st.integers(0, 1000))
    q = ranked_critics(ensemble)
    low = F.subset_minimum(q, size, torch.Generator().manual_seed(seed))
    again = F.subset_minimum(q, size, torch.Generator().manual_seed(seed))
    assert low.shape == (3, 1)
    assert torch.equal(low, again)
    assert (low == low[0]).all()
    # Among `size` distinct critics of `ensemble` ranks, one is at most ensemble - size.
    assert 0 <= low[0].item() <= ensemble - size


def test_subset_minimum_draws_every_critic() -> None:
    generator = torch.Generator().manual_seed(0)
    drawn = {F.subset_minimum(ranked_critics(4), 2, generator)[0].item() for _ in range(200)}
    assert drawn == {0.0, 1.0, 2.0}


@pytest.mark.parametrize("size", [None, 4])
def test_subset_minimum_of_all_draws_no_random_number(size: int | None) -> None:
    before = torch.get_rng_state()
    low = F.subset_minimum(ranked_critics(4), size)
    assert torch.equal(low, torch.zeros(3, 1))
    assert torch.equal(before, torch.get_rng_state())


def test_ensemble_mean_by_hand() -> None:
    torch.testing.assert_close(F.ensemble_mean(ranked_critics(4)), torch.full((3, 1), 1.5))


# --------------------------------------------------------------------------------- masked mean


def test_masked_mean_divides_by_the_marked_rows() -> None:
    values = torch.tensor([1.0, 2.0, 6.0, math.nan], requires_grad=True)
    mean = F.masked_mean(values, torch.tensor([True, False, True, False]))
    (gradient,) = torch.autograd.grad(mean, values)
    torch.testing.assert_close(mean, torch.tensor(3.5))
    torch.testing.assert_close(gradient, torch.tensor([0.5, 0.0, 0.5, 0.0]))


def test_masked_mean_of_no_rows_is_zero_with_zero_gradient() -> None:
    values = torch.tensor([1.0, 2.0], requires_grad=True)
    mean = F.masked_mean(values, torch.tensor([False, False]))
    (gradient,) = torch.autograd.grad(mean, values)
    assert mean.item() == 0.0
    assert torch.equal(gradient, torch.zeros(2))


# -------------------------------------------------------------------------------------- errors

COLUMN, ROWS, SCALAR = torch.zeros(4, 1), torch.zeros(4), torch.zeros(())
FALSE = COLUMN.bool()
WRONG_SHAPES = {
    "a row of rewards": lambda: F.soft_td_target(ROWS, FALSE, COLUMN, gamma=1.0),
    "other next_q": lambda: F.soft_td_target(COLUMN, FALSE, COLUMN[1:], gamma=1.0),
    "a column of log_prob": lambda: F.soft_td_target(
        COLUMN, FALSE, COLUMN, gamma=1.0, next_log_prob=COLUMN, temperature=SCALAR
    ),
    "a row of steps": lambda: F.soft_td_target(COLUMN, FALSE, COLUMN, gamma=1.0, steps=ROWS),
    "q without ensemble": lambda: F.critic_error(COLUMN, COLUMN),
    "a row of targets": lambda: F.critic_error(COLUMN[None], ROWS),
    "log_prob and q": lambda: F.actor_objective(COLUMN, COLUMN, SCALAR),
    "q as a row": lambda: F.actor_objective(ROWS, ROWS, SCALAR),
    "temperature": lambda: F.temperature_objective(COLUMN, SCALAR, -1.0),
    "mask as a column": lambda: F.masked_mean(ROWS, FALSE),
    "minimum without ensemble": lambda: F.subset_minimum(COLUMN),
    "mean without ensemble": lambda: F.ensemble_mean(COLUMN),
}


@pytest.mark.parametrize("call", WRONG_SHAPES.values(), ids=WRONG_SHAPES.keys())
def test_a_shape_that_would_broadcast_is_an_error(call: object) -> None:
    with pytest.raises(ValueError, match="expected"):
        call()  # type: ignore[operator]


def test_an_entropy_bonus_without_its_weight_is_an_error() -> None:
    with pytest.raises(ValueError, match="needs its weight: give temperature"):
        F.soft_td_target(COLUMN, FALSE, COLUMN, gamma=1.0, next_log_prob=ROWS)


@pytest.mark.parametrize("size", [0, 5])
def test_subset_minimum_refuses_sizes_outside_the_ensemble(size: int) -> None:
    with pytest.raises(ValueError, match="1 to 4 critics"):
        F.subset_minimum(ranked_critics(4), size)
