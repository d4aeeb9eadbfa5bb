"""Temperature: where it starts, and where it is drawn to."""

from __future__ import annotations

import math

import pytest
import torch

from losses import BCSACLoss, Temperature
from tests.losses.toys import ACTION_SIZE, Critic, make_actor, make_batch, make_loss


def test_the_loss_is_minus_log_alpha_times_the_excess() -> None:
    """log alpha = -2, log-densities 8 and 10, target 7: -(-2) * (9 - 7) = 4; slope -(9 - 7)."""
    log_alpha = torch.tensor(-2.0, requires_grad=True)
    loss = Temperature(target_entropy=-7.0)(torch.tensor([8.0, 10.0]), log_alpha).loss
    assert loss.item() == 4.0
    loss.backward()
    assert log_alpha.grad is not None
    assert log_alpha.grad.item() == -2.0


def test_it_names_the_entropy_that_it_aims_at() -> None:
    term = Temperature().resolved(make_actor())
    assert term.constants() == {"target_entropy": -2.0}
    assert Temperature(target_entropy=-45).constants() == {"target_entropy": -45.0}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"init": 0.0}, "init must be > 0, got 0.0"),
        ({"target_entropy": "low"}, "target_entropy must be auto or a number of nats, got 'low'"),
    ],
)
def test_a_bad_setting_is_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Temperature(**settings)  # type: ignore[arg-type]


def test_the_temperature_may_be_fixed_and_starts_where_told() -> None:
    loss = make_loss(init_temperature=0.2, learn_temperature=False)
    assert loss.alpha.item() == pytest.approx(0.2)
    assert not loss.alpha_loss(make_batch(4, demo_rows=None)).requires_grad


def test_the_temperature_s_loss_takes_a_batch_or_log_densities() -> None:
    loss = make_loss(target_entropy=-7.0, init_temperature=math.exp(-2.0))
    by_hand = loss.alpha_loss(torch.tensor([8.0, 10.0]))  # -(-2) * (9 - 7)
    assert by_hand.item() == pytest.approx(4.0)
    batch = make_batch(12, demo_rows=4)
    torch.manual_seed(1)
    from_batch = loss.alpha_loss(batch)
    torch.manual_seed(1)
    log_prob = loss.actor_terms(batch[:8]).log_prob
    torch.testing.assert_close(from_batch, loss.alpha_loss(log_prob))


def test_auto_target_entropy_is_minus_the_action_s_size() -> None:
    assert make_loss().target_entropy == -ACTION_SIZE


def test_auto_target_entropy_without_a_spec_names_the_remedy() -> None:
    with pytest.raises(ValueError, match="build the actor with spec="):
        BCSACLoss(make_actor(with_spec=False), [Critic()])
    assert (
        BCSACLoss(make_actor(with_spec=False), [Critic()], target_entropy=-1).target_entropy == -1
    )
