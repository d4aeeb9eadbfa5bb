"""Errors on demonstrated actions: values and gradients worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torchrl.modules import TanhNormal

from losses import imitation_errors as E


def test_negative_log_likelihood_by_hand() -> None:
    # Standard normal before tanh, actions tanh(0) and tanh(1). Per dimension
    # u^2/2 + log(2 pi)/2 + log(1 - a^2): 0.918939 and 0.5 + 0.918939 - 0.867562 = 0.551377.
    policy = TanhNormal(torch.zeros(1, 2), torch.ones(1, 2))
    error = E.negative_log_likelihood(policy, torch.tensor([[0.0, math.tanh(1.0)]]))
    torch.testing.assert_close(error, torch.tensor([0.918939 + 0.551377]), atol=2e-6, rtol=0)


@pytest.mark.parametrize("edge", [1.0, -1.0, 1.7, -1.0001, math.inf])
@pytest.mark.parametrize("margin", [1e-2, 1e-3])
def test_nll_and_its_gradient_are_bounded_at_and_beyond_the_edge(
    edge: float, margin: float
) -> None:
    """The pre-tanh value is at most atanh(1 - margin), so |d nll/d loc| <= that / scale^2."""
    loc = torch.zeros(1, 1, dtype=torch.float32, requires_grad=True)
    scale = torch.full((1, 1), 0.3, dtype=torch.float32, requires_grad=True)
    action = E.clamp_to_support(torch.tensor([[edge]], dtype=torch.float32), margin)
    error = E.negative_log_likelihood(TanhNormal(loc, scale), action)
    by_loc, by_scale = torch.autograd.grad(error.sum(), (loc, scale))
    largest = math.atanh(1.0 - margin)
    assert torch.isfinite(error).all()
    assert by_loc.abs().item() == pytest.approx(largest / 0.3**2, rel=1e-3)
    assert by_loc.sign().item() == -math.copysign(1.0, edge)
    assert by_scale.abs().item() <= largest**2 / 0.3**3


def test_the_docstring_s_figures_for_28_saturated_dimensions() -> None:
    policy = TanhNormal(
        torch.zeros(1, 28, dtype=torch.float32), torch.full((1, 28), 0.3, dtype=torch.float32)
    )
    for margin, nats in ((1e-6, 7796), (1e-3, 2064), (1e-2, 972)):
        action = E.clamp_to_support(torch.ones(1, 28, dtype=torch.float32), margin)
        assert E.negative_log_likelihood(policy, action).item() == pytest.approx(nats, rel=0.01)


def test_clamp_leaves_interior_actions_alone() -> None:
    action = torch.tensor([-2.0, -0.9, 0.0, 0.9, 2.0])
    expected = torch.tensor([-0.95, -0.9, 0.0, 0.9, 0.95])
    torch.testing.assert_close(E.clamp_to_support(action, 0.05), expected)


def test_mean_action_error_by_hand() -> None:
    # The policy's action is (0.5, -0.5): errors 0.25 and 0, mean of squares 0.03125.
    loc = torch.tensor([[0.5, -0.5]]).atanh().requires_grad_()
    scale = torch.ones(1, 2, requires_grad=True)
    error = E.mean_action_error(TanhNormal(loc, scale), torch.tensor([[0.25, -0.5]]))
    torch.testing.assert_close(error, torch.tensor([0.03125]))
    by_loc, by_scale = torch.autograd.grad(error.sum(), (loc, scale), allow_unused=True)
    # d/d loc = (2/A) (a - a_demo) (1 - a^2) = 0.25 * 0.75
    torch.testing.assert_close(by_loc, torch.tensor([[0.1875, 0.0]]))
    assert by_scale is None


def test_fixed_width_nll_by_hand() -> None:
    """The policy's action is (0.5, -0.5): errors 0.3 and 0.

    0.3^2 / (2 * 0.04) = 1.125, and each dimension adds log(0.2 * 2.506628) = -0.690499.
    """
    loc = torch.tensor([[0.5, -0.5]]).atanh().requires_grad_()
    scale = torch.ones(1, 2, requires_grad=True)
    error = E.fixed_width_nll(TanhNormal(loc, scale), torch.tensor([[0.2, -0.5]]))
    torch.testing.assert_close(error, torch.tensor([1.125 - 1.380999]), atol=2e-6, rtol=0)
    by_loc, by_scale = torch.autograd.grad(error.sum(), (loc, scale), allow_unused=True)
    # d/d loc = (a - a_demo) (1 - a^2) / 0.04 = 0.3 * 0.75 / 0.04
    torch.testing.assert_close(by_loc, torch.tensor([[5.625, 0.0]]))
    assert by_scale is None


def test_a_regression_asks_for_no_step_beyond_the_bound_that_a_likelihood_asks_for() -> None:
    """A saturated action that the policy all but takes, tanh(2) = 0.96.

    Under a likelihood with scale 0.05 it is (atanh(0.99) - 2) / 0.05^2 = 258.7 nats a unit away,
    under a fixed width (0.99 - 0.9640) * 0.0707 / 0.04 = 0.0459.
    """
    loc = torch.full((1, 1), 2.0, requires_grad=True)
    action = E.clamp_to_support(torch.ones(1, 1), 1e-2)
    pulls = [
        torch.autograd.grad(error(TanhNormal(loc, torch.full((1, 1), 0.05)), action).sum(), loc)[0]
        for error in (E.negative_log_likelihood, E.fixed_width_nll)
    ]
    assert [-pull.item() for pull in pulls] == pytest.approx([258.66, 0.0459], rel=1e-2)
