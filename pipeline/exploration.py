"""Which of the parallel environments act with noise."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.modules import ProbabilisticActor


class PartlyGreedyPolicy(TensorDictModuleBase):
    """Acts with the policy's mean action in the first environments and samples in the others.

    What is evaluated is the mean action, and a policy that learns from samples alone never meets
    what its mean runs into: on the door, noise shakes a hand free that would stand still.

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
