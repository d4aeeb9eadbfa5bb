"""Networks and batches of the loss tests: small enough to reason about."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal

from losses import BCSACLoss

OBSERVATION_SIZE = 3
ACTION_SIZE = 2


class Critic(nn.Module):
    """A two-layer ``(observation, action) -> [B, 1]`` critic."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(OBSERVATION_SIZE + ACTION_SIZE, 8), nn.Tanh(), nn.Linear(8, 1)
        )

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.net(torch.cat([observation, action], -1))


class ConstantCritics(nn.Module):
    """Critics whose values are given numbers, whatever they see: ``[E, B, 1]``."""

    def __init__(self, *values: float) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.tensor(values))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        # The zero keeps the graph to the action, as in a critic that does look at it.
        return self.values[:, None, None] + 0.0 * action.sum(-1, keepdim=True)


def make_actor(observation_key: str = "observation", with_spec: bool = True) -> ProbabilisticActor:
    net = nn.Sequential(
        nn.Linear(OBSERVATION_SIZE, 8),
        nn.Tanh(),
        nn.Linear(8, 2 * ACTION_SIZE),
        NormalParamExtractor(),
    )
    return ProbabilisticActor(
        TensorDictModule(net, [observation_key], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=Bounded(-1.0, 1.0, (ACTION_SIZE,)) if with_spec else None,
        distribution_class=TanhNormal,
    )


def make_batch(rows: int, demo_rows: int | None) -> TensorDict:
    """``rows`` transitions of which the last ``demo_rows`` are marked; ``None``: no marks."""
    batch = TensorDict(
        {
            "observation": torch.randn(rows, OBSERVATION_SIZE),
            "action": torch.rand(rows, ACTION_SIZE) * 1.6 - 0.8,
            "next": {
                "observation": torch.randn(rows, OBSERVATION_SIZE),
                "reward": torch.randn(rows, 1),
                "done": torch.arange(rows).unsqueeze(-1) % 2 == 0,
                "terminated": torch.arange(rows).unsqueeze(-1) % 4 == 0,
            },
        },
        [rows],
    )
    if demo_rows is not None:
        batch["is_demo"] = torch.arange(rows).unsqueeze(-1) >= rows - demo_rows
    return batch


def make_full_batch(rows: int, demo_rows: int) -> TensorDict:
    """The same with all that a batch may have besides: every third row's end is not known."""
    batch = make_batch(rows, demo_rows)
    batch["steps_to_next_obs"] = torch.full((rows, 1), 3)
    batch["imitated_action"] = torch.rand(rows, ACTION_SIZE) * 1.6 - 0.8
    batch["to_end"] = TensorDict(
        {
            "reward": 10.0 * torch.rand(rows, 1),
            "steps": torch.arange(rows).unsqueeze(-1) % 3,
            "observation": torch.randn(rows, OBSERVATION_SIZE),
            "terminated": torch.arange(rows).unsqueeze(-1) % 2 == 0,
        },
        [rows],
    )
    return batch


def make_loss(**options: object) -> BCSACLoss:
    return BCSACLoss(make_actor(), [Critic(), Critic()], **options)  # type: ignore[arg-type]


def q_of(loss: BCSACLoss, batch: TensorDict) -> Tensor:
    """The critics' values ``[E, R, 1]`` of the batch's own actions."""
    return loss.critic_terms(batch).values["qvalue"].measured["q_data"]


def target_of(loss: BCSACLoss, batch: TensorDict) -> Tensor:
    """What the critics are regressed on ``[R, 1]``."""
    return loss.critic_terms(batch).values["qvalue"].measured["q_target"]


def gradients(loss: Tensor, module: nn.Module) -> list[Tensor]:
    """Gradients of ``loss`` for the parameters of ``module``, zeros where there is none."""
    parameters = list(module.parameters())
    found = torch.autograd.grad(loss, parameters, retain_graph=True, allow_unused=True)
    return [torch.zeros_like(p) if g is None else g for p, g in zip(parameters, found, strict=True)]
