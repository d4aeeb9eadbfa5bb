"""SoftValue: what the actor maximises."""

from __future__ import annotations

import pytest
import torch

from losses import ActorPass, BCSACLoss, Objective, SoftTD, SoftValue, Temperature
from tests.losses.toys import ConstantCritics, make_actor, make_batch


@pytest.mark.parametrize(("value", "q"), [("min", 1.0), ("mean", 3.0)])
def test_the_loss_is_the_mean_of_alpha_log_pi_minus_q(value: str, q: float) -> None:
    """alpha = 0.5: half the mean log-density less Q, of the actions that were drawn."""
    term = SoftValue(value)  # type: ignore[arg-type]
    terms = [SoftTD(), term, Temperature(init=0.5)]
    loss = Objective(make_actor(), ConstantCritics(2.0, 1.0, 6.0), terms)
    seen = ActorPass(loss, loss.batch(make_batch(4, demo_rows=None)))
    found = term(seen)
    log_prob = seen.sample.log_prob
    assert found.loss.item() == pytest.approx(0.5 * log_prob.mean().item() - q)
    assert torch.equal(found.measured["entropy"], -log_prob)
    assert not any(tensor.requires_grad for tensor in found.measured.values())


def test_a_bad_setting_is_named() -> None:
    with pytest.raises(ValueError, match="value must be min or mean, got 'max'"):
        SoftValue("max")  # type: ignore[arg-type]


@pytest.mark.parametrize(("actor_value", "expected"), [("min", 1.0), ("mean", 3.0)])
def test_what_the_actor_maximises_of_the_ensemble(actor_value: str, expected: float) -> None:
    loss = BCSACLoss(make_actor(), ConstantCritics(2.0, 1.0, 6.0), actor_value=actor_value)
    torch.testing.assert_close(
        loss.actor_terms(make_batch(4, demo_rows=None)).values["rl"].measured["q_policy"],
        torch.full((4, 1), expected),
    )
