"""What two policies propose, chosen by values worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from losses import BCSACLoss, Proposal, SoftTD
from losses.policy import policy_distribution
from tests.losses.toys import Critic, make_actor, make_batch, target_of

OWN = torch.tensor([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]])


def shown_by(actor, observation: Tensor) -> Tensor:
    return policy_distribution(actor, observation).deterministic_sample.detach()


def judge(of_own: list[float], of_shown: list[float]):
    """Values of the two proposals, whatever they are; they are asked for at once."""

    def value(observation: Tensor, action: Tensor) -> Tensor:
        assert len(observation) == len(action) == 2 * len(of_own)
        assert torch.equal(action[: len(OWN)], OWN)
        return torch.tensor([*of_own, *of_shown])[:, None]

    return value


def test_the_better_of_two_is_taken():
    """1 > 0; 2 < 5; of two alike one's own."""
    actor, observation = make_actor(), torch.randn(3, 3)
    action, value = Proposal(actor)(observation, OWN, judge([1.0, 2.0, 4.0], [0.0, 5.0, 4.0]))
    assert value.squeeze(-1).tolist() == [1.0, 5.0, 4.0]
    assert torch.equal(action, torch.stack([OWN[0], shown_by(actor, observation)[1], OWN[2]]))


def test_the_soft_variant_draws_by_exp_of_beta_times_the_value():
    """Q differs by ln 3 / 2 and beta is 2: odds of 3 to 1, so the clone's has 3/4."""
    torch.manual_seed(0)
    rows, actor = 20_000, make_actor()
    own, gain = torch.zeros(rows, 2), math.log(3.0) / 2.0

    def value(_: Tensor, action: Tensor) -> Tensor:
        return torch.cat([torch.zeros(rows, 1), torch.full((rows, 1), gain)])

    proposal = Proposal(actor, beta=2.0)
    _, drawn = proposal(torch.zeros(rows, 3), own, value)
    # Four standard deviations of the share: 4 sqrt(3/16 / 20000) = 0.012.
    assert abs((drawn > 0.0).float().mean().item() - 0.75) < 0.013
    _, best = proposal(torch.zeros(rows, 3), own, value, greedy=True)
    assert (best == gain).all()


def test_the_target_takes_the_better_action_of_the_next_state(monkeypatch: pytest.MonkeyPatch):
    """r + gamma (1 - d) max Q': the same numbers as with each of the two alone, row by row."""
    clone, batch = make_actor(), make_batch(32, demo_rows=None)
    loss = BCSACLoss(
        make_actor(), [Critic(), Critic()], gamma=0.9, entropy_in_target=False,
        target_action="mean", proposal=Proposal(clone),
    )  # fmt: skip
    after, ended = batch["next", "observation"], batch["next", "terminated"]
    of_each = [
        loss.target_critic(after, shown_by(actor, after)).min(0).values
        for actor in (loss.actor, clone)
    ]
    assert 0 < (of_each[0] < of_each[1]).sum() < 32, "either is the better one somewhere"
    best = torch.maximum(*of_each).masked_fill(ended, 0.0)
    expected = batch["next", "reward"] + 0.9 * best
    torch.testing.assert_close(target_of(loss, batch), expected)


def test_the_clone_does_not_learn_and_is_no_part_of_the_loss():
    loss = BCSACLoss(
        make_actor(), [Critic()], entropy_in_target=False, proposal=Proposal(make_actor())
    )
    assert not any("proposal" in key for key in loss.state_dict())
    found = loss(make_batch(6, demo_rows=2))
    sum(found[key] for key in ("loss_qvalue", "loss_actor")).backward()
    assert all(p.grad is None for p in loss.composition["qvalue"].proposal.actor.parameters())


def test_an_entropy_bonus_is_of_one_policy():
    with pytest.raises(ValueError, match="entropy must be False with a proposal"):
        SoftTD(proposal=Proposal(make_actor()))
    with pytest.raises(ValueError, match="beta must be None or > 0"):
        Proposal(make_actor(), beta=0.0)
