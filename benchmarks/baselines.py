"""SAC of other packages as installed, on the same sizes and filled buffers.

stable-baselines3 and sbx (its JAX port) run their own ``train``, which samples. torchrl's
``SACLoss`` runs the update of its own recipe (sota-implementations/sac): one sum of the losses, one
backward, three Adams, ``SoftUpdate``. None of them has an imitation term.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.data import Bounded, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate, group_optimizers

from envs.door.task import ACTION_SIZE, OBSERVATION_SIZE

LEARNING_RATE = 1e-5  # of the paper; it has no bearing on the time
TAU = 0.005


class SpacesOnly(gym.Env[np.ndarray, np.ndarray]):
    """An environment of the door's sizes that is never stepped: the packages want one."""

    observation_space = spaces.Box(-np.inf, np.inf, (OBSERVATION_SIZE,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)


class StableBaselines:
    """``train`` of stable-baselines3's or sbx's SAC.

    It returns when the update is finished: both read the losses back as numbers.
    """

    def __init__(self, model: Any, logger: Any, batch: int, gradient_steps: int) -> None:
        model.set_logger(logger)
        buffer = model.replay_buffer
        rng = np.random.default_rng(0)
        for rows in (buffer.observations, buffer.next_observations, buffer.rewards):
            rows[:] = rng.standard_normal(rows.shape, dtype=np.float32)
        buffer.actions[:] = rng.uniform(-1.0, 1.0, buffer.actions.shape)
        buffer.full = True
        self.model = model
        self.batch = batch
        self.gradient_steps = gradient_steps
        self.units = float(gradient_steps)

    def call(self) -> None:
        """One call of ``train``."""
        self.model.train(gradient_steps=self.gradient_steps, batch_size=self.batch)


def make_stable_baselines(
    package: str,
    width: int,
    batch: int,
    replay_rows: int,
    gradient_steps: int,
    device: str = "cpu",
) -> StableBaselines:
    """SAC of ``package`` (``stable_baselines3`` or ``sbx``, which takes the device JAX chooses)."""
    # Only here: the rest of this module must load without the extra `bench`.
    from stable_baselines3.common.logger import Logger  # noqa: PLC0415

    if package == "sbx":
        from sbx import SAC  # noqa: PLC0415
    else:
        from stable_baselines3 import SAC  # noqa: PLC0415
    model = SAC(
        "MlpPolicy",
        SpacesOnly(),
        learning_rate=LEARNING_RATE,
        buffer_size=replay_rows,
        batch_size=batch,
        policy_kwargs={"net_arch": [width, width]},
        seed=0,
        device=device,
    )
    return StableBaselines(model, Logger(folder=None, output_formats=[]), batch, gradient_steps)


def make_torchrl_actor(width: int) -> ProbabilisticActor:
    """The policy of torchrl's own recipe."""
    body = nn.Sequential(
        MLP(
            in_features=OBSERVATION_SIZE,
            out_features=2 * ACTION_SIZE,
            num_cells=[width, width],
            activation_class=nn.ReLU,
        ),
        NormalParamExtractor(scale_mapping="biased_softplus_1.0", scale_lb=0.1),
    )
    spec = Bounded(-1.0, 1.0, (ACTION_SIZE,))
    return ProbabilisticActor(
        TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=spec,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": spec.space.low, "high": spec.space.high, "tanh_loc": False},
        return_log_prob=False,
    )


def make_torchrl_critic(width: int, *, layer_norm: bool = False) -> ValueOperator:
    """The critic of torchrl's own recipe, which the losses multiply."""
    norm: dict[str, Any] = {}
    if layer_norm:
        kwargs = [{"normalized_shape": width}] * 2
        norm = {"norm_class": nn.LayerNorm, "norm_kwargs": kwargs}
    body = MLP(
        in_features=OBSERVATION_SIZE + ACTION_SIZE,
        out_features=1,
        num_cells=[width, width],
        activation_class=nn.ReLU,
        **norm,
    )
    return ValueOperator(body, in_keys=["action", "observation"])


def make_torchrl_buffer(
    rows: int, batch: int, *, prefetch: int | None, device: str = "cpu"
) -> TensorDictReplayBuffer:
    """A filled replay buffer of transitions with the keys that torchrl's losses read."""
    flag = torch.zeros(rows, 1, dtype=torch.bool)
    content = TensorDict(
        {
            "observation": torch.randn(rows, OBSERVATION_SIZE),
            "action": torch.rand(rows, ACTION_SIZE) * 2 - 1,
            "next": {
                "observation": torch.randn(rows, OBSERVATION_SIZE),
                "reward": torch.randn(rows, 1),
                "done": flag,
                "terminated": flag.clone(),
            },
        },
        batch_size=[rows],
    )
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(rows, device=device), batch_size=batch, prefetch=prefetch
    )
    buffer.extend(content)
    return buffer


class TorchRLSAC:
    """One update of torchrl's recipe."""

    units = 1.0

    def __init__(self, width: int, batch: int, replay_rows: int, device: str = "cpu") -> None:
        torch.manual_seed(0)
        self.loss = SACLoss(
            make_torchrl_actor(width).to(device),
            make_torchrl_critic(width).to(device),
            num_qvalue_nets=2,
            loss_function="l2",
            delay_actor=False,
            delay_qvalue=True,
        )
        self.loss.make_value_estimator(gamma=0.99)
        self.loss.to(device)
        self.target = SoftUpdate(self.loss, tau=TAU)
        adams = [
            torch.optim.Adam(list(parameters.flatten_keys().values()), lr=LEARNING_RATE)
            for parameters in (self.loss.actor_network_params, self.loss.qvalue_network_params)
        ]
        adams.append(torch.optim.Adam([self.loss.log_alpha], lr=LEARNING_RATE))
        self.optimizer = group_optimizers(*adams)
        self.buffer = make_torchrl_buffer(replay_rows, batch, prefetch=3, device=device)
        self.device = torch.device(device)

    def call(self) -> None:
        """Samples and updates."""
        terms = self.loss(self.buffer.sample())
        (terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]).backward()
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.target.step()
        finish(self.device)


def make_torchrl_sac(width: int, batch: int, replay_rows: int, device: str = "cpu") -> TorchRLSAC:
    """The SAC of torchrl's recipe at a size."""
    return TorchRLSAC(width, batch, replay_rows, device)


def finish(device: torch.device) -> None:
    """Wait until ``device`` has done what it was given: a processor has."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
