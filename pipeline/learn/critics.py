"""The critics: several networks of one shape, evaluated together.

The paper's size (section IV-B) is 66 x 1024 x 1024 x 1 for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torchrl.envs import EnvBase

from pipeline.learn.networks import CriticSettings, HiddenLayers, ObservationNormalizer


class EnsembleLinear(nn.Module):
    """``E`` independent linear layers evaluated as one batched matrix product.

    ``torchrl.modules.EnsembleModule`` does the same through vmap over functional parameters, at
    about 1.5 times the cost of an update on CPU; one ``baddbmm`` keeps ordinary parameters.
    """

    def __init__(self, num_members: int, in_features: int, out_features: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(num_members, in_features, out_features))
        self.bias = nn.Parameter(torch.zeros(num_members, 1, out_features))
        for member in self.weight.data:
            nn.init.orthogonal_(member)

    def forward(self, x: Tensor) -> Tensor:
        """Maps ``[E, B, I]`` to ``[E, B, J]``."""
        return torch.baddbmm(self.bias, x, self.weight)


class EnsembleValue(EnsembleLinear):
    """``E`` independent maps of features to one number: :class:`EnsembleLinear` with one output.

    A matrix product with a single column, and the outer product that is its gradient, run on CPU
    at a small part of the speed of memory: as a sum of products the same numbers, gradients
    included, take a quarter of the time or less (docs/performance.md).
    """

    def __init__(self, num_members: int, in_features: int) -> None:
        super().__init__(num_members, in_features, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Maps ``[E, B, I]`` to ``[E, B, 1]``."""
        return torch.linalg.vecdot(x, self.weight.mT).unsqueeze(-1) + self.bias


class EnsembleLayerNorm(nn.Module):
    """Layer normalisation with separate scale and shift for each of ``E`` members."""

    def __init__(self, num_members: int, features: int) -> None:
        super().__init__()
        self.features = features
        self.weight = nn.Parameter(torch.ones(num_members, 1, features))
        self.bias = nn.Parameter(torch.zeros(num_members, 1, features))

    def forward(self, x: Tensor) -> Tensor:
        """Maps ``[E, B, F]`` to ``[E, B, F]``."""
        normalised = nn.functional.layer_norm(x, (self.features,))
        return torch.addcmul(self.bias, normalised, self.weight)


class BatchedCritics(nn.Module):
    """``E`` state-action value networks, evaluated together.

    Args:
        observation_size: ``O``.
        action_size: ``A``.
        hidden: Widths of the hidden layers.
        num_critics: ``E``.
        layer_norm: Normalise before each activation (bounds the overestimation off the data).
        normalizer: Optional observation standardisation.
        hidden_dtype: See :class:`HiddenLayers`.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        hidden: Sequence[int],
        num_critics: int,
        *,
        layer_norm: bool = False,
        normalizer: ObservationNormalizer | None = None,
        hidden_dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        if num_critics < 1:
            raise ValueError(f"critic.num_critics must be at least 1, got {num_critics}.")
        self.num_critics = num_critics
        self.normalizer = normalizer if normalizer is not None else nn.Identity()
        sizes = [observation_size + action_size, *hidden]
        layers: list[nn.Module] = []
        for n_in, n_out in pairwise(sizes):
            layers.append(EnsembleLinear(num_critics, n_in, n_out))
            if layer_norm:
                layers.append(EnsembleLayerNorm(num_critics, n_out))
            layers.append(nn.ReLU(inplace=True))
        self.hidden = HiddenLayers(nn.Sequential(*layers), hidden_dtype)
        self.head = EnsembleValue(num_critics, sizes[-1])

    def forward(self, observation: Tensor, action: Tensor, members: Tensor | None = None) -> Tensor:
        """Maps observation ``[B, O]`` and action ``[B, A]`` to values ``[E, B, 1]``.

        Of ``members [M]`` only, where some are named: ``[M, B, 1]``.
        """
        if members is not None:
            # Every parameter has a leading dimension of members.
            chosen = {name: value[members] for name, value in self.named_parameters()}
            return functional_call(self, chosen, (observation, action))
        x = torch.cat([self.normalizer(observation), action], dim=-1)
        return self.head(self.hidden(x.expand(len(self.head.weight), *x.shape)))


def make_critic(
    critic: CriticSettings,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
    chunk: int = 1,
) -> BatchedCritics:
    """The critic ensemble for the spaces of ``env``, of so many actions at once."""
    return BatchedCritics(
        env.observation_spec["observation"].shape[-1],
        chunk * env.action_spec.shape[-1],
        critic.hidden,
        critic.num_critics,
        layer_norm=critic.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)
