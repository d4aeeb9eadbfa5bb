"""How much noise a policy acts with: none in some environments, or a part of its own."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.modules import ProbabilisticActor


def require_noise_scale(scale: float) -> None:
    """Raise ``ValueError`` unless ``scale`` is positive and finite."""
    if not 0.0 < scale < float("inf"):
        raise ValueError(
            f"evaluation.noise_scale must be positive and finite, got {scale}; "
            "for no noise set evaluation.exploration=mean."
        )


class EpisodeNoise(TensorDictModuleBase):
    """Samples actions whose noise belongs to the episode, not to the batch it is stepped in.

    Step t of episode i gets the same draw whatever is stepped beside it and on whatever device, so
    an evaluation does not depend on how many episodes are stepped together.

    Args:
        actor: Of ``pipeline.learn.networks.make_actor``; its weights are shared.
        seed: Of the list of episodes.
        scale: Factor on the policy's standard deviation before the tanh: 1 samples like ``actor``,
            towards 0 a sample becomes the mean action.

    Raises:
        ValueError: If ``scale`` is not positive and finite.
    """

    AT_ONCE = 64
    """Steps that are drawn together. Part of what the numbers are: do not change it."""

    def __init__(self, actor: ProbabilisticActor, seed: int, scale: float = 1.0) -> None:
        super().__init__()
        require_noise_scale(scale)
        self.actor = actor
        self.seed = seed
        self.scale = scale
        self.in_keys = list(actor.in_keys)
        self.out_keys = list(actor[-1].out_keys[:1])
        self._episodes: list[np.random.Generator] = []
        self._drawn = torch.empty(0)
        self._step = 0

    def begin(self, first: int, count: int) -> None:
        """Goes to the first step of episodes ``first``, ..., ``first + count - 1``."""
        numbers = range(first, first + count)
        self._episodes = [np.random.default_rng([self.seed, number]) for number in numbers]
        self._step = 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action [N, A] for the observation [N, O], N being the ``count`` of episodes.

        Raises:
            RuntimeError: If they have not begun, or N is another.
        """
        policy = self.actor.get_dist(tensordict)
        if policy.loc.shape[0] != len(self._episodes):
            raise RuntimeError(
                f"{policy.loc.shape[0]} episodes are stepped, and {len(self._episodes)} have "
                "begun: call begin(first, count) when they start."
            )
        noise = self.scale * self._next(policy.loc)
        return tensordict.set(self.out_keys[0], policy.action_of(noise))

    def _next(self, like: Tensor) -> Tensor:
        """Draws of the next step [N, A], of dtype and device of ``like``."""
        step = self._step % self.AT_ONCE
        if step == 0:
            size = (self.AT_ONCE, like.shape[-1])
            drawn = [rng.standard_normal(size, dtype=np.float32) for rng in self._episodes]
            self._drawn = torch.from_numpy(np.stack(drawn, axis=1)).to(like)
        self._step += 1
        return self._drawn[step]


class PartlyGreedyPolicy(TensorDictModuleBase):
    """Acts with the policy's mean action in the first environments and samples in the others.

    What is evaluated is the mean action as a rule, and a policy that learns from samples alone
    never meets what its mean runs into: on the door, noise shakes a hand free that would stand
    still.

    Args:
        actor: Being trained; its weights are shared.
        greedy: Environments, of the batch's first dimension, that take the mean action.
        num_envs: Size of that dimension.

    Raises:
        ValueError: If ``greedy`` is not between 0 and ``num_envs``.
    """

    def __init__(self, actor: ProbabilisticActor, greedy: int, num_envs: int) -> None:
        super().__init__()
        if not 0 <= greedy <= num_envs:
            raise ValueError(
                f"collector.greedy_envs must be between 0 and env.num_envs={num_envs}, "
                f"got {greedy}."
            )
        self.actor = actor
        self.greedy = greedy
        self.in_keys = list(actor.in_keys)
        self.out_keys = list(actor[-1].out_keys[:1])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action [N, A] for the observation [N, O]."""
        policy = self.actor.get_dist(tensordict)
        action = policy.sample()
        action[: self.greedy] = policy.deterministic_sample[: self.greedy]
        return tensordict.set(self.out_keys[0], action)
