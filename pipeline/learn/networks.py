"""The actor, built from plain values, and the parts that it shares with the critics.

The paper's size (section IV-B) is 38 x 1024 x 1024 x 56: its outputs are the mean and the log
standard deviation of 28 actions.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from pydantic.dataclasses import dataclass as settings
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import MLP, ProbabilisticActor

from losses import SquashedNormal
from pipeline.settings import STRICT, Count, Widths

OBSERVATION_CLIP = 5.0  # normalised observations are clipped to this many standard deviations
MIN_STD = 1e-2  # an observation that hardly varies in the demonstrations is not blown up


@settings(frozen=True, kw_only=True, config=STRICT)
class ActorSettings:
    """Diagonal Gaussian policy squashed by tanh (paper IV-B: 38 x 1024 x 1024 x 56)."""

    hidden: Widths = (1024, 1024)
    log_std_min: float = -5.0
    log_std_max: float = 2.0
    layer_norm: bool = False
    normalise_observations: bool = False  # by the mean and std of the demonstrations
    # Actions given at once, of which none looks at what the ones before it led to; loss.n_step too.
    chunk: Count = 1


@settings(frozen=True, kw_only=True, config=STRICT)
class CriticSettings:
    """Ensemble of Q networks (paper IV-B: two of 66 x 1024 x 1024 x 1)."""

    hidden: Widths = (1024, 1024)
    num_critics: Count = 2
    layer_norm: bool = False
    normalise_observations: bool = False


class ObservationNormalizer(nn.Module):
    """Standardises observations with fixed statistics that travel with the weights.

    Args:
        mean: Shape ``[O]``.
        std: Shape ``[O]``; floored at ``MIN_STD``.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, mean: Tensor, std: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean.clone())
        self.register_buffer("std", std.clamp_min(MIN_STD))

    @classmethod
    def identity(cls, size: int) -> ObservationNormalizer:
        """Zero mean and unit standard deviation: a place to load statistics into."""
        return cls(torch.zeros(size), torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        """Maps ``[..., O]`` to ``[..., O]``, clipped to ``OBSERVATION_CLIP``."""
        scaled = (observation - self.mean) / self.std
        return scaled.clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)


class GaussianHead(nn.Module):
    """Splits ``[..., 2A]`` into a mean ``[..., A]`` and a bounded standard deviation ``[..., A]``.

    The log standard deviation is squashed by tanh into ``[log_std_min, log_std_max]``, as the
    paper's base implementation (denisyarats/pytorch_sac) does: unlike a clamp it keeps a gradient.
    """

    def __init__(self, log_std_min: float, log_std_max: float) -> None:
        super().__init__()
        if log_std_min >= log_std_max:
            raise ValueError(
                f"actor.log_std_min ({log_std_min}) must be below actor.log_std_max "
                f"({log_std_max})."
            )
        self.log_std_min = log_std_min
        self.log_std_max = log_std_max

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Returns ``(loc, scale)``."""
        loc, raw = features.chunk(2, dim=-1)
        half_range = 0.5 * (self.log_std_max - self.log_std_min)
        log_std = self.log_std_min + half_range * (torch.tanh(raw) + 1.0)
        return loc, log_std.exp()


class HiddenLayers(nn.Module):
    """Hidden layers in a lower precision between float32 inputs and outputs.

    Parameters, heads, distributions and losses stay float32: a tanh Gaussian in bfloat16 cannot
    tell actions above 0.996 apart.

    Args:
        layers: Maps ``[..., I]`` to ``[..., J]``.
        dtype: What the matrix products are computed in; None is the parameters' own.
    """

    def __init__(self, layers: nn.Module, dtype: torch.dtype | None = None) -> None:
        super().__init__()
        self.layers = layers
        self.dtype = dtype

    def forward(self, x: Tensor) -> Tensor:
        """Maps ``[..., I]`` to ``[..., J]`` in float32."""
        if self.dtype is None:
            return self.layers(x)
        with torch.autocast(x.device.type, self.dtype):
            return self.layers(x).float()


def make_actor(
    observation_size: int,
    action_size: int,
    hidden: Sequence[int],
    *,
    log_std_min: float = -5.0,
    log_std_max: float = 2.0,
    layer_norm: bool = False,
    normalizer: ObservationNormalizer | None = None,
    hidden_dtype: torch.dtype | None = None,
) -> ProbabilisticActor:
    """Builds the tanh-squashed diagonal Gaussian policy ``pi(a | s)`` (paper, section III-A).

    Reads ``observation`` [..., O]; writes ``loc``, ``scale`` and ``action`` [..., A] in (-1, 1).
    """
    trunk = MLP(
        in_features=observation_size,
        out_features=hidden[-1],
        num_cells=list(hidden[:-1]),
        activation_class=nn.ReLU,
        activation_kwargs={"inplace": True},
        norm_class=nn.LayerNorm if layer_norm else None,
        norm_kwargs=[{"normalized_shape": width} for width in hidden] if layer_norm else None,
        activate_last_layer=True,
    )
    output = nn.Linear(hidden[-1], 2 * action_size)
    orthogonal_(trunk)
    orthogonal_(output)
    body = nn.Sequential(
        normalizer if normalizer is not None else nn.Identity(),
        HiddenLayers(trunk, hidden_dtype),
        output,
        GaussianHead(log_std_min, log_std_max),
    )
    return ProbabilisticActor(
        TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=SquashedNormal,
        return_log_prob=False,
    )


def make_policy(
    actor: ActorSettings,
    env: EnvBase,
    normalizer: ObservationNormalizer | None,
    device: str,
    hidden_dtype: torch.dtype | None = None,
) -> ProbabilisticActor:
    """The actor for the spaces of ``env``."""
    return make_actor(
        env.observation_spec["observation"].shape[-1],
        actor.chunk * env.action_spec.shape[-1],
        actor.hidden,
        log_std_min=actor.log_std_min,
        log_std_max=actor.log_std_max,
        layer_norm=actor.layer_norm,
        normalizer=normalizer,
        hidden_dtype=hidden_dtype,
    ).to(device)


def orthogonal_(module: nn.Module, gain: float = 1.0) -> None:
    """Orthogonal weights and zero biases, as in the paper's base implementation."""
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            nn.init.orthogonal_(layer.weight, gain=gain)
            nn.init.zeros_(layer.bias)
