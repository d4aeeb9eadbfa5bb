"""SoftTD: what the critics are drawn to, and which critics say so."""

from __future__ import annotations

import math
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from losses import BCSACLoss, CriticEnsemble, CriticPass, Objective, SoftTD, SoftValue, Temperature
from tests.losses.toys import (
    ConstantCritics,
    Critic,
    make_actor,
    make_batch,
    make_loss,
    target_of,
)


def by_hand(term: SoftTD, batch: TensorDict) -> tuple[float, list[float]]:
    """Loss and targets of critics worth 2 and 5 whose targets are worth 1 and 6."""
    terms = [term, SoftValue(), Temperature(init=0.5)]
    loss = Objective(make_actor(), ConstantCritics(1.0, 6.0), terms)
    with torch.no_grad():
        loss.critic.values.copy_(torch.tensor([2.0, 5.0]))
    found = term(CriticPass(loss, loss.batch(batch)))
    assert torch.equal(found.measured["q_data"][:, 0, 0], torch.tensor([2.0, 5.0]))
    return found.loss.item(), found.measured["q_target"].squeeze(-1).tolist()


def two_rows() -> TensorDict:
    """Rewards 3 and 4; the second row ends the episode, the first is three steps long."""
    batch = make_batch(2, demo_rows=None)
    batch["next", "reward"] = torch.tensor([[3.0], [4.0]])
    batch["next", "terminated"] = torch.tensor([[False], [True]])
    return batch.set("steps_to_next_obs", torch.tensor([[3], [1]]))


def test_the_loss_is_the_mean_squared_error_summed_over_critics() -> None:
    """Targets 3 + 0.5^3 min(1, 6) = 3.125 and 4.

    Errors (2 - 3.125)^2 + (5 - 3.125)^2 = 1.265625 + 3.515625 = 4.78125 and (2 - 4)^2 + (5 - 4)^2
    = 5; their mean is 4.890625.
    """
    loss, target = by_hand(SoftTD(gamma=0.5, entropy=False), two_rows())
    assert target == [3.125, 4.0]
    assert loss == pytest.approx(4.890625)


def test_the_distance_may_be_another() -> None:
    """|2 - 3.125| + |5 - 3.125| = 3 and |2 - 4| + |5 - 4| = 3."""
    loss, _ = by_hand(SoftTD(gamma=0.5, entropy=False, distance="l1"), two_rows())
    assert loss == pytest.approx(3.0)


def test_the_entropy_bonus_is_alpha_times_the_density() -> None:
    """With alpha = 0.5 and gamma = 1: 3 + 1 - 0.5 log pi; the drawn action has that density."""
    batch = two_rows()
    actor = make_actor()
    loss = BCSACLoss(actor, ConstantCritics(1.0, 6.0), gamma=1.0, init_temperature=0.5)
    torch.manual_seed(2)
    target = target_of(loss, batch)
    torch.manual_seed(2)
    policy = actor.get_dist(batch["next"].select("observation"))
    _, log_prob = policy.rsample_and_log_prob()
    assert target[0].item() == pytest.approx(4.0 - 0.5 * log_prob[0].item())
    assert target[1].item() == 4.0


def test_the_target_is_no_part_of_the_graph() -> None:
    loss = make_loss()
    assert not target_of(loss, make_batch(4, demo_rows=None)).requires_grad


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gamma": math.nan}, r"gamma must be in \[0, 1\], got nan"),
        ({"tau": 2}, r"tau must be in \[0, 1\], got 2"),
        ({"target_subset": 0}, "target_subset must be None or >= 1, got 0"),
        ({"target_action": "mode"}, "target_action must be sample or mean, got 'mode'"),
        ({"target_action": "mean"}, "entropy must be False with target_action='mean'"),
        ({"distance": "l3"}, "distance must be l2, l1 or smooth_l1, got 'l3'"),
    ],
)
def test_a_bad_setting_is_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SoftTD(**settings)  # type: ignore[arg-type]


def test_steps_discount_the_future_by_their_number() -> None:
    """gamma over two steps is gamma squared over one."""
    batch = make_batch(12, demo_rows=None)
    loss = make_loss(gamma=0.9)
    two_steps = batch.clone().set("steps_to_next_obs", torch.full((12, 1), 2))
    torch.manual_seed(1)
    in_two_steps = target_of(loss, two_steps)
    loss.configure("qvalue", gamma=0.81)
    torch.manual_seed(1)
    torch.testing.assert_close(in_two_steps, target_of(loss, batch))


def test_only_a_termination_ends_the_return() -> None:
    loss = make_loss()
    batch = make_batch(12, demo_rows=None)
    reward, target = batch["next", "reward"], target_of(loss, batch)
    terminated = batch["next", "terminated"]
    assert (batch["next", "done"] & ~terminated).any()  # truncations: they bootstrap
    assert torch.equal(target == reward, terminated)


def test_the_target_can_do_without_entropy() -> None:
    targets = []
    for temperature in (0.1, 10.0):
        torch.manual_seed(0)
        loss = make_loss(entropy_in_target=False, init_temperature=temperature)
        targets.append(target_of(loss, make_batch(12, demo_rows=None)))
    assert torch.equal(*targets)


def test_the_target_can_value_the_policy_without_its_noise() -> None:
    """The critic is the sum of the action, so the target shows which action it was asked about."""

    class ActionSum(nn.Module):
        def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
            return action.sum(-1, keepdim=True).expand(1, -1, 1)

    actor, batch = make_actor(), make_batch(6, demo_rows=None)
    batch["next", "terminated"] = torch.zeros_like(batch["next", "terminated"])
    batch["next", "reward"] = torch.zeros_like(batch["next", "reward"])
    following = batch["next"].select("observation")
    mean = actor.get_dist(following).deterministic_sample.sum(-1, keepdim=True)
    for action, is_mean in (("mean", True), ("sample", False)):
        loss = BCSACLoss(
            actor, ActionSum(), target_action=action, gamma=1.0, entropy_in_target=False
        )
        assert torch.allclose(target_of(loss, batch), mean) == is_mean


@pytest.mark.parametrize("action", ["sample", "mean"])
def test_only_a_sampled_action_is_drawn(action: str) -> None:
    loss = make_loss(target_action=action, entropy_in_target=False)
    batch = make_batch(6, demo_rows=None)
    before = torch.random.get_rng_state()
    loss.critic_terms(batch)
    assert torch.equal(torch.random.get_rng_state(), before) == (action == "mean")


@pytest.mark.parametrize(("subset", "values"), [(None, {1.0}), (1, {1.0, 2.0, 6.0}), (3, {1.0})])
def test_the_target_takes_the_minimum_over_a_random_subset(
    subset: int | None, values: set[float]
) -> None:
    critic = ConstantCritics(2.0, 1.0, 6.0)
    loss = BCSACLoss(make_actor(), critic, target_subset=subset, gamma=1.0, entropy_in_target=False)
    batch = make_batch(4, demo_rows=None)
    batch["next", "reward"].zero_()
    batch["next", "terminated"].zero_()
    seen = {target_of(loss, batch)[0].item() for _ in range(60)}
    assert seen == values


class CountingCritics(CriticEnsemble):
    """Notes how many members each call runs."""

    ran: ClassVar[list[int]] = []

    def forward(self, observation, action, members=None):
        q = super().forward(observation, action, members)
        self.ran.append(len(q))
        return q


class WithoutMembers(nn.Module):
    """An ensemble that cannot run a part of itself."""

    def __init__(self, critics: CriticEnsemble) -> None:
        super().__init__()
        self.critics = critics

    def forward(self, observation, action):
        return self.critics(observation, action)


def test_critics_outside_the_target_subset_are_not_run() -> None:
    critics = CountingCritics([Critic() for _ in range(5)])
    batch = make_batch(6, demo_rows=None)
    targets = []
    actor = make_actor()
    for critic in (critics, WithoutMembers(critics)):
        critics.ran.clear()
        loss = BCSACLoss(actor, critic, target_subset=2)
        torch.manual_seed(3)
        targets.append(target_of(loss, batch))
        assert critics.ran == ([2, 5] if critic is critics else [5, 5])
    torch.testing.assert_close(*targets)
