"""The pipeline's update is the plain one: TorchRL's SACLoss, separate networks, separate Adams.

Everything that was made faster is on one side (closed-form density, policies called on tensors,
batched critics, fused optimizers shared by actor and temperature, batches drawn together), none of
it on the other. Both compute in float64: Adam divides by the gradient's own size, which lets
float32's rounding grow over the updates until nothing could be told apart.
"""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import SACLoss, SoftUpdate

from losses import BCSACLoss
from pipeline.data.buffers import DemonstrationDistribution, make_buffer, make_core_buffer
from pipeline.data.mixture import BatchPart, Mixture
from pipeline.learn.critics import BatchedCritics, EnsembleLayerNorm, EnsembleLinear
from pipeline.learn.networks import make_actor
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, make_batch

pytestmark = pytest.mark.usefixtures("float64")

UPDATES = 50
GAMMA, TAU, WEIGHT = 0.9, 0.05, 0.7
HIDDEN, CRITICS = [16, 12], 2
ACTOR_LR, CRITIC_LR, TEMPERATURE_LR = 3e-3, 5e-3, 1e-2
MAIN_ROWS, DEMO_ROWS = 8, 4


class OrdinaryCritic(nn.Module):
    """One critic of ordinary layers, with the weights of one member of ``critics``."""

    def __init__(self, critics: BatchedCritics, member: int) -> None:
        super().__init__()
        layers = [*critics.hidden.layers, critics.head]
        self.layers = nn.Sequential(*(ordinary(layer, member) for layer in layers))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.layers(torch.cat([observation, action], -1))


@torch.no_grad()
def ordinary(layer: nn.Module, member: int) -> nn.Module:
    if isinstance(layer, EnsembleLinear):
        _, n_in, n_out = layer.weight.shape
        made: nn.Module = nn.Linear(n_in, n_out)
        made.weight.copy_(layer.weight[member].T)
    elif isinstance(layer, EnsembleLayerNorm):
        made = nn.LayerNorm(layer.features)
        made.weight.copy_(layer.weight[member, 0])
    else:
        return nn.ReLU()
    made.bias.copy_(layer.bias[member, 0])
    return made


class Reference:
    """BC-SAC out of TorchRL's parts, one optimizer for each of the three things that learn."""

    def __init__(self, actor: ProbabilisticActor, critics: BatchedCritics) -> None:
        self.actor = ProbabilisticActor(
            deepcopy(actor[0]),
            in_keys=["loc", "scale"],
            distribution_class=TanhNormal,
            distribution_kwargs={"low": -1.0, "high": 1.0},
        )
        keys = ["observation", "action"]
        self.sac = SACLoss(
            self.actor,
            [
                TensorDictModule(OrdinaryCritic(critics, member), keys, ["state_action_value"])
                for member in range(CRITICS)
            ],
            loss_function="l2",
            alpha_init=0.1,
            target_entropy=-float(ACTION_SIZE),
        )
        self.sac.make_value_estimator(gamma=GAMMA)
        self.targets = SoftUpdate(self.sac, tau=TAU)
        actor_parameters = self.sac.actor_network_params.values(True, True)
        critic_parameters = self.sac.qvalue_network_params.values(True, True)
        self.critic_adam = torch.optim.Adam(critic_parameters, lr=CRITIC_LR, fused=False)
        self.actor_adam = torch.optim.Adam(actor_parameters, lr=ACTOR_LR, fused=False)
        self.temperature_adam = torch.optim.Adam(
            [self.sac.log_alpha], lr=TEMPERATURE_LR, fused=False
        )

    def update(self, batch: TensorDict, seed: int) -> None:
        batch["next", "done"] = batch["next", "terminated"].clone()
        torch.manual_seed(seed)
        self._step(self.critic_adam, self.sac(batch.clone())["loss_qvalue"])
        # The same draws again, now before the critic that has just learnt.
        torch.manual_seed(seed)
        terms = self.sac(batch.clone())
        objective = terms["loss_actor"] + WEIGHT * self._imitation(batch)
        self._step(self.actor_adam, objective)
        self._step(self.temperature_adam, terms["loss_alpha"])
        self.targets.step()

    def _imitation(self, batch: TensorDict) -> Tensor:
        demos = batch[batch["is_demo"].squeeze(-1)]
        with self.sac.actor_network_params.to_module(self.sac.actor_network):
            policy = self.sac.actor_network.get_dist(demos.select("observation"))
        return -policy.log_prob(demos["action"]).mean()

    def _step(self, optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def critics(self, which: str) -> dict[str, Tensor]:
        """Parameters by name, of all members: ``[E, ...]``."""
        parameters = getattr(self.sac, f"{which}_network_params")
        return dict(parameters.flatten_keys(".").detach().items())


def as_ordinary(critics: BatchedCritics) -> dict[str, Tensor]:
    """The parameters of batched critics under the names and in the shapes of ordinary ones."""
    members = [OrdinaryCritic(critics, member).state_dict() for member in range(CRITICS)]
    names = members[0]
    return {f"module.layers.{n[7:]}": torch.stack([m[n] for m in members]) for n in names}


def transitions(rows: int) -> TensorDict:
    """Random transitions of one to three steps, one in five of which ends its episode."""
    batch = make_batch(rows)
    batch["steps_to_next_obs"] = torch.randint(1, 4, (rows, 1))
    batch["next", "terminated"] = torch.rand(rows, 1) < 0.2
    return batch


def make_ours(layer_norm: bool) -> BCSACLoss:
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, HIDDEN, layer_norm=layer_norm)
    sizes = (OBSERVATION_SIZE, ACTION_SIZE, HIDDEN, CRITICS)
    critics = BatchedCritics(*sizes, layer_norm=layer_norm)
    return BCSACLoss(
        actor,
        critics,
        gamma=GAMMA,
        tau=TAU,
        target_entropy=-float(ACTION_SIZE),
        bc_weight=WEIGHT,
        rl_on_demos=True,  # TorchRL's loss has no other rows
    )


def make_stepper(loss: BCSACLoss) -> BCSACStepper:
    return BCSACStepper(
        loss,
        actor_lr=ACTOR_LR,
        critic_lr=CRITIC_LR,
        temperature_lr=TEMPERATURE_LR,
        # Of the 50 updates, every seventh takes the actor's two gradients one by one.
        schedule=UpdateSchedule(target_period=1, diagnostics_period=7),
    )


def make_mixture() -> Mixture:
    main = make_buffer(64)
    main.extend(transitions(64))
    demos = DemonstrationDistribution(make_core_buffer(transitions(16)))
    parts = {
        "main": BatchPart(main, MAIN_ROWS),
        "demos": BatchPart(demos, DEMO_ROWS, is_demo=True),
    }
    return Mixture(parts, draws=16)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_fifty_updates_end_where_the_plain_ones_end(layer_norm: bool):
    ours = make_ours(layer_norm)
    start = deepcopy(ours.state_dict())
    reference = Reference(ours.actor, ours.critic)
    stepper, mixture = make_stepper(ours), make_mixture()
    for update in range(UPDATES):
        batch = mixture.sample()
        torch.manual_seed(1000 + update)
        stepper.step(None, batch)
        reference.update(batch.clone(), 1000 + update)
        torch.manual_seed(update)  # of the mixture's next draw

    def close(mine: object, other: object) -> None:
        torch.testing.assert_close(mine, other, rtol=1e-6, atol=1e-9)

    their_actor = reference.sac.actor_network_params.flatten_keys(".").detach()
    my_actor = dict(ours.actor.named_parameters())
    assert set(my_actor) == {name for name, _ in their_actor.items()}
    close({name: value.detach() for name, value in my_actor.items()}, dict(their_actor.items()))
    close(as_ordinary(ours.critic), reference.critics("qvalue"))
    close(as_ordinary(ours.target_critic), reference.critics("target_qvalue"))
    close(ours.log_alpha.detach(), reference.sac.log_alpha.detach())
    # They have really moved: farther than any tolerance, every one of them.
    for name, value in ours.state_dict().items():
        if value.is_floating_point():
            assert (value - start[name]).abs().max() > 1e-3, name
