"""Self-imitation against numbers worked out by hand, and what it leaves alone."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from losses import ActorPass, Objective, SelfImitation, SoftTD, SoftValue, Temperature
from losses import functional as F
from losses.imitation_errors import negative_log_likelihood
from losses.terms import Term
from tests.losses.toys import ConstantCritics, gradients, make_actor, make_batch, make_loss

SAC = (SoftTD(), SoftValue(), Temperature(init=1.0))


class FirstOfState(nn.Module):
    """One critic whose value is the first entry of the observation: ``[1, B, 1]``."""

    def __init__(self) -> None:
        super().__init__()
        self.factor = nn.Parameter(torch.ones(()))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return (self.factor * observation[:, :1] + 0.0 * action.sum(-1, keepdim=True))[None]


def objective(term: Term, critic: nn.Module | None = None) -> Objective:
    return Objective(make_actor(), FirstOfState() if critic is None else critic, [*SAC, term])


def ending_batch(
    states: list[float],
    rewards: list[float],
    steps: list[int],
    last: list[float],
    terminated: list[bool],
    demo_rows: int | None = None,
) -> TensorDict:
    """Rows by the first entry of their state, and the way to the end of their episodes."""
    batch = make_batch(len(states), demo_rows)
    batch["observation"][:, 0] = torch.tensor(states)
    end = torch.zeros_like(batch["observation"])
    end[:, 0] = torch.tensor(last)
    batch["to_end"] = TensorDict(
        {
            "reward": torch.tensor(rewards)[:, None],
            "steps": torch.tensor(steps)[:, None],
            "observation": end,
            "terminated": torch.tensor(terminated)[:, None],
        },
        [len(states)],
    )
    return batch


def values(loss: Objective, batch: TensorDict) -> tuple[float, float, Tensor]:
    """The term, its share of better rows, and each row's error."""
    seen = ActorPass(loss, loss.batch(batch))
    term = loss.composition["self_imitation"]
    found = term(seen)
    errors = negative_log_likelihood(seen.policy, batch["action"])
    return found.loss.item(), found.measured["better_share"].item(), errors.detach()


def test_advantages_by_hand():
    """R - V is 3 - 1, 1 - 4 and 5 - 1: what fell short of its value does not count."""
    returns, value = torch.tensor([3.0, 1.0, 5.0]), torch.tensor([1.0, 4.0, 1.0])
    assert F.positive_advantage(returns, value).tolist() == [2.0, 0.0, 4.0]
    assert F.positive_advantage(returns, value, cap=2.5).tolist() == [2.0, 0.0, 2.5]
    with pytest.raises(ValueError, match="expected tensors of shape"):
        F.positive_advantage(returns, value[:, None])


@pytest.mark.parametrize(("cap", "advantages"), [(None, [2.0, 0.0, 3.0]), (2.5, [2.0, 0.0, 2.5])])
def test_it_is_the_error_times_the_advantage(cap: float | None, advantages: list[float]):
    """V(s) is 1, 4, 1. The second and third go on with 8 at discount 1/2.

    R = 3; 2 + 8/4 = 4, no more than V; 3 + 8/8 = 4. The divisor is all three rows.
    """
    loss = objective(SelfImitation(gamma=0.5, entropy=False, cap=cap))
    ends = ([1.0, 4.0, 1.0], [3.0, 2.0, 3.0], [5, 2, 3], [99.0, 8.0, 8.0], [True, False, False])
    found, share, errors = values(loss, ending_batch(*ends))
    assert found == pytest.approx((errors * torch.tensor(advantages)).sum().item() / 3, rel=1e-5)
    assert share == pytest.approx(2 / 3)


def test_without_a_bootstrap_a_return_ends_with_its_episode():
    """R - V = 2 - 1, where it would be 2 + 8/4 - 1."""
    ends = ([1.0], [2.0], [2], [8.0], [False])
    found = {}
    for bootstrap in (False, True):
        loss = objective(SelfImitation(gamma=0.5, entropy=False, bootstrap=bootstrap))
        found[bootstrap], _, errors = values(loss, ending_batch(*ends))
        assert found[bootstrap] == pytest.approx((3.0 if bootstrap else 1.0) * errors.item())


def test_rows_whose_end_is_not_known_count_neither_above_nor_below():
    """The second is unknown: the mean is over the first and the third, 2 e and 4 e."""
    loss = objective(SelfImitation(entropy=False))
    known = ([1.0, 1.0, 1.0], [3.0, 7.0, 5.0], [5, 0, 5], [0.0] * 3, [True] * 3)
    found, share, errors = values(loss, ending_batch(*known))
    assert found == pytest.approx((2 * errors[0] + 4 * errors[2]).item() / 2, rel=1e-5)
    assert share == 1.0


def test_the_value_carries_the_entropy_where_it_is_asked_to(monkeypatch: pytest.MonkeyPatch):
    """Q = 2 and log pi = -3 at alpha = 1/2 make V = 2 + 1.5, and R = 4 exceeds it by 0.5."""
    drawn = (torch.zeros(1, 2), torch.tensor([-3.0]))
    monkeypatch.setattr("losses.self_imitation.draw", lambda *_: drawn)
    ends = ([0.0], [4.0], [1], [0.0], [True])
    for entropy, advantage in ((True, 0.5), (False, 2.0)):
        loss = objective(SelfImitation(entropy=entropy), ConstantCritics(2.0, 7.0))
        with torch.no_grad():
            loss.log_alpha.fill_(math.log(0.5))
        found, _, errors = values(loss, ending_batch(*ends))
        assert found == pytest.approx(advantage * errors.item(), rel=1e-5)


def test_the_mean_of_the_critics_is_a_value_too():
    """Of 2 and 6: min leaves 7 - 2, mean 7 - 4."""
    for value, advantage in (("min", 5.0), ("mean", 3.0)):
        term = SelfImitation(entropy=False, value=value)
        loss = objective(term, ConstantCritics(2.0, 6.0))
        found, _, errors = values(loss, ending_batch([0.0], [7.0], [1], [0.0], [True]))
        assert found == pytest.approx(advantage * errors.item(), rel=1e-5)


def test_it_trains_the_actor_alone():
    loss = make_loss(further=[SelfImitation(weight=0.5)])
    batch = ending_batch([0.0] * 4, [50.0] * 4, [3] * 4, [0.0] * 4, [True] * 4, demo_rows=2)
    found = loss(batch)
    assert any(bool(g.any()) for g in gradients(found["loss_self_imitation"], loss.actor))
    assert not any(bool(g.any()) for g in gradients(found["loss_self_imitation"], loss.critic))
    torch.testing.assert_close(found["loss_self_imitation"], 0.5 * found["self_imitation"])
    assert found["better_share"].item() == 1.0


def test_a_batch_that_tells_no_ends_leaves_it_out():
    found = make_loss(further=[SelfImitation()])(make_batch(6, demo_rows=2))
    assert found["self_imitation"].item() == found["better_share"].item() == 0.0
    assert not found["loss_self_imitation"].requires_grad


def test_the_policy_of_each_state_acts_there(monkeypatch: pytest.MonkeyPatch):
    """Q is the action's first entry, the policy's mean: R - V compares the last state's and own."""

    class FirstOfAction(ConstantCritics):
        def forward(self, observation: Tensor, action: Tensor) -> Tensor:
            return action[None, :, :1]

    monkeypatch.setattr(
        "losses.self_imitation.draw",
        lambda policy, _: (policy.deterministic_sample, torch.zeros(len(policy.loc))),
    )
    loss = objective(SelfImitation(gamma=1.0, entropy=False), FirstOfAction(0.0))
    batch = ending_batch([-3.0, 3.0], [0.0, 0.0], [1, 1], [3.0, -3.0], [False, False])
    found, _, errors = values(loss, batch)
    last, own = (
        ActorPass(loss, loss.batch(TensorDict({"observation": seen}, [2]))).policy
        for seen in (batch["to_end", "observation"], batch["observation"])
    )
    gain = (last.deterministic_sample - own.deterministic_sample)[:, 0].clamp(min=0.0)
    assert gain.max() > 0.0
    assert found == pytest.approx((errors * gain).sum().item() / 2, rel=1e-5)


@pytest.mark.parametrize(
    "setting", [{"gamma": 1.1}, {"margin": 1.0}, {"cap": 0.0}, {"error": "l2"}]
)
def test_settings_out_of_range_are_refused(setting: dict):
    (name,) = setting
    with pytest.raises(ValueError, match=f"{name} must be"):
        SelfImitation(**setting)
