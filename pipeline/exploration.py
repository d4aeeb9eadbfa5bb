"""How much noise a policy acts with: none in some environments, or a part of its own."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torchrl.modules import ProbabilisticActor


def require_noise_scale(scale: float) -> None:
    """Raise ``ValueError`` unless ``scale`` is positive and finite."""
    if not 0.0 < scale < float("inf"):
        raise ValueError(
            f"evaluation.noise_scale must be positive and finite, got {scale}; "
            "for no noise set evaluation.exploration=mean."
        )


def with_noise(actor: ProbabilisticActor, scale: float) -> ProbabilisticTensorDictSequential:
    """The same policy, its standard deviation before the tanh times ``scale``.

    Args:
        actor: Its weights are shared. Its first module writes ``scale`` [..., A].
        scale: 1 samples like ``actor``; towards 0 a sample becomes the mean action.

    Raises:
        ValueError: If ``scale`` is not positive and finite.
    """
    require_noise_scale(scale)
    quieter = TensorDictModule(lambda std: std * scale, in_keys=["scale"], out_keys=["scale"])
    return ProbabilisticTensorDictSequential(actor[0], quieter, actor[-1])


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
