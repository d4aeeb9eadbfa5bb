"""Imitation: the error of the demonstration rows, and what it weighs them by."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from losses import (
    ActorPass,
    BCSACLoss,
    Emphasis,
    ExponentialWeight,
    GradientRatio,
    Imitation,
    QFilter,
)
from tests.losses.toys import gradients, make_actor, make_batch, make_loss, q_of


def seen_of(loss: BCSACLoss, rows: int, demo_rows: int | None) -> ActorPass:
    return ActorPass(loss, loss.batch(make_batch(rows, demo_rows)))


def test_the_squared_error_by_hand() -> None:
    """A policy whose deterministic action is 0: rows (0.6, 0) and (0, -0.2).

    (0.36 + 0) / 2 = 0.18 and (0 + 0.04) / 2 = 0.02; their mean is 0.1.
    """
    loss = make_loss()
    for parameter in loss.actor.parameters():
        parameter.data.zero_()
    batch = make_batch(3, demo_rows=2)
    batch["action"][-2:] = torch.tensor([[0.6, 0.0], [0.0, -0.2]])
    found = Imitation("mse")(ActorPass(loss, loss.batch(batch)))
    assert found.loss.item() == pytest.approx(0.1)


def test_row_weights_multiply_and_the_divisor_stays() -> None:
    """Of the same rows, weighed 2 * 0.5 and 4 * 0: (0.18 * 1 + 0.02 * 0) / 2 = 0.09."""
    loss = make_loss()
    for parameter in loss.actor.parameters():
        parameter.data.zero_()
    batch = make_batch(3, demo_rows=2)
    batch["action"][-2:] = torch.tensor([[0.6, 0.0], [0.0, -0.2]])
    first = Emphasis(lambda observation: torch.tensor([math.inf, 2.0, 4.0]))
    second = Emphasis(lambda observation: torch.tensor([math.nan, 0.5, 0.0]))
    term = Imitation("mse", row_weights=[first, second])
    seen = ActorPass(loss, loss.batch(batch))
    assert term(seen).loss.item() == pytest.approx(0.09)
    assert term.demonstration_error(seen).item() == pytest.approx(0.1)


def test_the_margin_is_where_demonstrated_actions_end() -> None:
    """With margin 0.5, actions of 1 are scored as 0.5: from 0, 0.25 in each dimension."""
    loss = make_loss()
    for parameter in loss.actor.parameters():
        parameter.data.zero_()
    batch = make_batch(2, demo_rows=2)
    batch["action"].fill_(1.0)
    found = Imitation("mse", margin=0.5)(ActorPass(loss, loss.batch(batch)))
    assert found.loss.item() == pytest.approx(0.25)


def test_without_marks_nothing_is_weighed() -> None:
    """The filter would run the critics for nothing."""

    def never(observation: Tensor) -> Tensor:
        raise AssertionError

    found = Imitation(row_weights=[Emphasis(never)])(seen_of(make_loss(), 4, None))
    assert found.loss.item() == 0.0


def test_a_ratio_scales_the_weight_by_the_gradients() -> None:
    """0.6 * 10 / 4 = 1.5; no gradient is no division by zero."""
    ratio = GradientRatio(2.0)
    weight, reference, own = torch.tensor([0.6, 10.0, 4.0])
    assert ratio(weight, reference, own).item() == pytest.approx(1.5)
    assert ratio(weight, reference, torch.tensor(0.0)).isfinite()
    assert ratio.factor == 2.0
    with pytest.raises(ValueError, match=r"ratio must be finite and >= 0, got -1\.0"):
        GradientRatio(-1.0)


def test_settings_are_what_they_were_given_as() -> None:
    term = Imitation("mse", ExponentialWeight(1.0, 0.5), row_weights=[QFilter()])
    assert term == Imitation("mse", ExponentialWeight(1.0, 0.5), row_weights=(QFilter(),))
    assert hash(term) == hash(Imitation("mse", ExponentialWeight(1.0, 0.5), 1e-2, (QFilter(),)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"error": "l2"}, "error must be nll, mse or fixed_width, got 'l2'"),
        ({"margin": 1.0}, r"margin must be in \(0, 1\), got 1.0"),
        ({"weight": -1.0}, "weight and must be finite and >= 0"),
    ],
)
def test_a_bad_setting_is_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Imitation(**settings)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="value must be min or mean, got 'max'"):
        QFilter("max")  # type: ignore[arg-type]


class SumOfActions(nn.Module):
    """One critic that values an action by the sum of its entries."""

    def forward(self, _observation: Tensor, action: Tensor) -> Tensor:
        return action.sum(-1, keepdim=True).unsqueeze(0)


def test_the_q_filter_leaves_out_demonstrations_worse_than_the_policy() -> None:
    """Rows 4-7 are demonstrations; the critic prefers large actions, so rows 4 and 5 stay."""
    actor = make_actor()
    loss = BCSACLoss(actor, SumOfActions(), q_filter=True)
    batch = make_batch(8, 4)
    batch["action"] = torch.tensor([0.99, 0.99, -0.99, -0.99] * 2).unsqueeze(-1).expand(8, 2)
    batch["action"] = batch["action"].contiguous()
    everything = BCSACLoss(actor, SumOfActions()).bc_loss(batch[4:6])
    # The mean is over all four demonstrations, of which two count.
    assert torch.isclose(loss.actor_terms(batch).values["bc"].loss, everything / 2)
    assert loss.actor_terms(batch).values["bc"].loss.requires_grad


def test_emphasis_multiplies_the_error_of_each_demonstrated_step() -> None:
    """The mean over three demonstrations of their own errors, times 2, 0 and 0.5."""
    factors = {0.0: 2.0, 1.0: 0.0, 2.0: 0.5}
    batch = make_batch(5, demo_rows=3)
    batch["observation"][-3:, 0] = torch.tensor(list(factors))
    loss = make_loss(
        bc_emphasis=lambda rows: torch.stack(
            [torch.tensor(factors.get(row[0].item(), 100.0)) for row in rows["observation"]]
        )
    )
    errors = [loss.bc_loss(batch[row : row + 1]) for row in (2, 4)]
    expected = (2.0 * errors[0] + 0.5 * errors[1]) / 3.0
    torch.testing.assert_close(loss.actor_terms(batch).values["bc"].loss, expected)
    torch.testing.assert_close(loss(batch)["bc_nll"], expected.detach())


def test_emphasis_and_q_filter_both_apply() -> None:
    batch = make_batch(6, demo_rows=6)
    loss = make_loss(q_filter=True, rl_on_demos=True)
    filtered = loss.actor_terms(batch).values["bc"].loss
    emphasis = Emphasis(lambda rows: torch.full((len(rows),), 3.0))
    loss.configure("bc", row_weights=[emphasis, QFilter()])
    torch.testing.assert_close(loss.actor_terms(batch).values["bc"].loss, 3.0 * filtered)


def test_without_the_q_filter_every_demonstration_counts() -> None:
    loss = BCSACLoss(make_actor(), SumOfActions())
    batch = make_batch(8, 4)
    assert torch.isclose(loss.actor_terms(batch).values["bc"].loss, loss.bc_loss(batch))


@pytest.mark.parametrize("edge", [1.0, -1.3])
def test_actions_at_and_beyond_the_edge_give_finite_gradients(edge: float) -> None:
    loss = make_loss()
    batch = make_batch(6, demo_rows=6)
    batch["action"].fill_(edge)
    at_the_edge = loss.bc_loss(batch)
    batch["action"].fill_(math.copysign(1.0 - loss.action_margin, edge))
    torch.testing.assert_close(at_the_edge, loss.bc_loss(batch))
    assert all(g.isfinite().all() for g in gradients(at_the_edge, loss.actor))


def test_the_imitation_term_is_the_mean_over_the_demonstrations_alone() -> None:
    loss = make_loss()
    batch = make_batch(12, demo_rows=4)
    alone = loss.bc_loss(batch[-4:])
    torch.testing.assert_close(loss.bc_loss(batch), alone)
    torch.testing.assert_close(loss.actor_terms(batch).values["bc"].loss, alone)
    one_by_one = torch.stack([loss.bc_loss(batch[row : row + 1]) for row in range(8, 12)])
    torch.testing.assert_close(one_by_one.mean(), alone)


@given(order=st.permutations(range(8)))
def test_the_imitation_term_does_not_care_where_its_rows_are(order: list[int]) -> None:
    loss = make_loss()
    batch = make_batch(8, demo_rows=3)
    torch.testing.assert_close(loss.bc_loss(batch[order]), loss.bc_loss(batch))


def test_the_clean_action_is_imitated_and_the_executed_one_valued() -> None:
    """Rows 4-7 are demonstrations whose executed actions are not those that they show."""
    loss = make_loss(rl_on_demos=True)
    shown = make_batch(8, 4)
    both = shown.clone()
    both["action"] = torch.rand_like(shown["action"]) - 0.5
    both["imitated_action"] = shown["action"].clone()
    executed = both.exclude("imitated_action")
    for imitation in (loss.bc_loss, lambda batch: loss.actor_terms(batch).values["bc"].loss):
        assert torch.equal(imitation(both), imitation(shown))
        assert not torch.isclose(imitation(both), imitation(executed))
    assert torch.equal(q_of(loss, both), q_of(loss, executed))
    assert not torch.isclose(q_of(loss, both), q_of(loss, shown)).any()


def test_the_q_filter_judges_what_would_be_imitated() -> None:
    """The critic prefers large actions: what was executed is worse than the policy's, yet stays."""
    loss = BCSACLoss(make_actor(), SumOfActions(), q_filter=True)
    batch = make_batch(8, 4)
    batch["imitated_action"] = torch.full_like(batch["action"], 0.99)
    batch["action"] = torch.full_like(batch["action"], -0.99)
    assert torch.isclose(loss.actor_terms(batch).values["bc"].loss, loss.bc_loss(batch))
    assert loss.actor_terms(batch.exclude("imitated_action")).values["bc"].loss == 0
