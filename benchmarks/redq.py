"""An RLPD-sized frame made of torchrl's ``REDQLoss``, the closest to it in that package.

``REDQLoss`` has the ensemble, the random subset in the target and the mean over the ensemble for
the actor. It computes the actor's and the critics' terms in every call (there is no critic-only
call), and it has no imitation term: torchrl's ``BCLoss`` stands in, on the actor's turn only.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.objectives import BCLoss, REDQLoss, SoftUpdate

from benchmarks.baselines import (
    LEARNING_RATE,
    TAU,
    make_torchrl_actor,
    make_torchrl_buffer,
    make_torchrl_critic,
)


class REDQFrame:
    """``critic_updates`` critic updates, the last with an actor and a temperature update too.

    The backward pass reaches only what is updated, so the frame costs what the loss class allows.
    """

    units = 1.0

    def __init__(
        self, width: int, batch: int, replay_rows: int, num_critics: int, critic_updates: int
    ) -> None:
        torch.manual_seed(0)
        actor = make_torchrl_actor(width)
        self.loss = REDQLoss(
            actor,
            make_torchrl_critic(width, layer_norm=True),
            num_qvalue_nets=num_critics,
            sub_sample_len=2,
            loss_function="l2",
        )
        self.loss.make_value_estimator(gamma=0.99)
        self.target = SoftUpdate(self.loss, tau=TAU)
        self.imitation = BCLoss(actor, loss_function=None)  # None is the likelihood
        critic_parameters = list(self.loss.qvalue_network_params.flatten_keys().values())
        actor_parameters = list(self.loss.actor_network_params.flatten_keys().values())
        self.critic_adam = torch.optim.Adam(critic_parameters, lr=LEARNING_RATE)
        self.actor_adam = torch.optim.Adam(
            [*actor_parameters, self.loss.log_alpha], lr=LEARNING_RATE
        )
        self.buffer = make_torchrl_buffer(replay_rows, batch, prefetch=3)
        self.demos = make_torchrl_buffer(batch * 20, batch // 2, prefetch=None)
        self.critic_updates = critic_updates

    def call(self) -> None:
        """One frame's updates."""
        for update in range(self.critic_updates):
            terms = self.loss(self.buffer.sample())
            if update == self.critic_updates - 1:
                self._actor_update(terms)
            terms["loss_qvalue"].backward()
            self.critic_adam.step()
            self.critic_adam.zero_grad(set_to_none=True)
            self.target.step()

    def _actor_update(self, terms: TensorDictBase) -> None:
        imitation = self.imitation(self.demos.sample())["loss_bc"]
        (terms["loss_actor"] + terms["loss_alpha"] + imitation).backward(retain_graph=True)
        self.actor_adam.step()
        self.actor_adam.zero_grad(set_to_none=True)


def make_redq_frame(
    width: int, batch: int, replay_rows: int, num_critics: int, critic_updates: int
) -> REDQFrame:
    """The frame at a size."""
    return REDQFrame(width, batch, replay_rows, num_critics, critic_updates)
