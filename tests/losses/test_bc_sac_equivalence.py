"""BC-SAC without imitation is TorchRL's SAC; its imitation term alone is TorchRL's BC.

Both sides get copies of the same networks, the same batch and the same seed, and must agree in
values, in the gradient of every parameter and after several updates with target networks.
"""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import BCLoss, SACLoss, SoftUpdate

from losses import BCSACLoss
from tests.losses.toys import Critic, gradients, make_actor, make_batch

GAMMA, TAU = 0.9, 0.25
LOSSES = ("loss_qvalue", "loss_actor", "loss_alpha")


def make_torchrl_sac(
    actor: ProbabilisticActor, critics: list[nn.Module]
) -> tuple[SACLoss, SoftUpdate]:
    """TorchRL's SAC with our defaults spelled out: squared error, initial temperature 0.1."""
    sac = SACLoss(
        deepcopy(actor),
        [
            TensorDictModule(deepcopy(critic), ["observation", "action"], ["state_action_value"])
            for critic in critics
        ],
        loss_function="l2",
        alpha_init=0.1,
    )
    sac.make_value_estimator(gamma=GAMMA)
    return sac, SoftUpdate(sac, tau=TAU)


def total(terms: TensorDict, names: tuple[str, ...] = LOSSES) -> torch.Tensor:
    return sum(terms[name] for name in names)  # type: ignore[return-value]


def torchrl_critic_gradients(sac: SACLoss) -> list[torch.Tensor]:
    """Gradients of TorchRL's stacked critics, unstacked and ordered as our parameters are."""
    stacked = dict(sac.qvalue_network_params.flatten_keys(".").items())
    return [p.grad[critic] for critic in range(2) for _, p in stacked.items()]


@pytest.fixture
def networks() -> tuple[ProbabilisticActor, list[nn.Module]]:
    return make_actor(), [Critic(), Critic()]


@pytest.mark.parametrize("demo_rows", [None, 5], ids=["no marks", "weight 0"])
def test_equals_sac_loss_in_values_and_gradients(networks, demo_rows: int | None) -> None:
    actor, critics = networks
    ours = BCSACLoss(actor, critics, gamma=GAMMA, bc_weight=0.0, rl_on_demos=True)
    theirs, _ = make_torchrl_sac(actor, critics)
    batch = make_batch(16, demo_rows)

    torch.manual_seed(1)
    our_terms = ours(batch)
    torch.manual_seed(1)
    their_terms = theirs(batch.clone())

    for name in (*LOSSES, "alpha", "entropy"):
        torch.testing.assert_close(our_terms[name], their_terms[name], msg=f"{name} differs")
    total(our_terms, (*LOSSES, "loss_bc")).backward()
    total(their_terms).backward()
    their_actor = theirs.actor_network_params.values(True, True)
    for mine, other in zip(actor.parameters(), their_actor, strict=True):
        torch.testing.assert_close(mine.grad, other.grad)
    torch.testing.assert_close(ours.log_alpha.grad, theirs.log_alpha.grad)
    our_gradients = sorted((p.grad for p in ours.critic.parameters()), key=lambda g: g.sum())
    their_gradients = sorted(torchrl_critic_gradients(theirs), key=lambda g: g.sum())
    for mine, other in zip(our_gradients, their_gradients, strict=True):
        torch.testing.assert_close(mine, other)


def test_equals_sac_loss_over_updates_with_target_networks(networks) -> None:
    actor, critics = networks
    ours = BCSACLoss(actor, critics, gamma=GAMMA, tau=TAU)
    theirs, their_targets = make_torchrl_sac(actor, critics)
    our_optimizer = torch.optim.SGD((p for p in ours.parameters() if p.requires_grad), lr=0.1)
    their_optimizer = torch.optim.SGD((p for p in theirs.parameters() if p.requires_grad), lr=0.1)
    for seed in range(4):
        batch = make_batch(16, demo_rows=None)
        torch.manual_seed(seed)
        our_terms = ours(batch)
        torch.manual_seed(seed)
        their_terms = theirs(batch.clone())
        for name in LOSSES:
            torch.testing.assert_close(our_terms[name], their_terms[name])
        for optimizer, terms in ((our_optimizer, our_terms), (their_optimizer, their_terms)):
            optimizer.zero_grad()
            total(terms).backward()
            optimizer.step()
        ours.update_target()
        their_targets.step()


def test_equals_sac_loss_on_the_rows_that_are_not_demonstrations(networks) -> None:
    """The values differ by the draw only: with one critic update's target fixed, not at all."""
    actor, critics = networks
    ours = BCSACLoss(actor, critics, gamma=GAMMA)
    theirs, _ = make_torchrl_sac(actor, critics)
    batch = make_batch(16, demo_rows=5)
    torch.manual_seed(1)
    mine = ours.qvalue_loss(batch)
    torch.manual_seed(1)
    other, _ = theirs.qvalue_v2_loss(batch[:11].clone())
    torch.testing.assert_close(mine, other)
    torch.manual_seed(1)
    mine = ours.actor_loss(batch)
    torch.manual_seed(1)
    other, _ = theirs.actor_loss(batch[:11].clone())
    torch.testing.assert_close(mine, other)


@pytest.mark.parametrize(("imitation", "loss_function"), [("nll", None), ("mse", "l2")])
def test_imitation_equals_bc_loss_inside_the_action_range(
    networks, imitation: str, loss_function: str | None
) -> None:
    actor, critics = networks
    ours = BCSACLoss(actor, critics, imitation=imitation)
    theirs = BCLoss(deepcopy(actor), loss_function=loss_function)
    batch = make_batch(16, demo_rows=5)
    assert batch["action"].abs().max() < 1.0 - ours.action_margin
    mine = ours.bc_loss(batch)
    other = theirs(batch[-5:].clone())["loss_bc"]
    torch.testing.assert_close(mine, other)
    other.backward()
    for gradient, parameter in zip(
        gradients(mine, actor), theirs.actor_network_params.values(True, True), strict=True
    ):
        expected = torch.zeros_like(gradient) if parameter.grad is None else parameter.grad
        torch.testing.assert_close(gradient, expected)
