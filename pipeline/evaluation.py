"""Evaluation of a policy over a fixed list of episodes (paper, section IV-D)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import DoorEnv, make_env
from envs.door.metrics import DoorMetrics, summarise
from envs.door.starts import door_position
from envs.door.task import LATCH, PALM_TO_HANDLE
from pipeline.exploration import require_noise_scale, with_noise
from pipeline.random_state import kept_random_state
from pipeline.threads import one_torch_thread

Exploration = Literal["mean", "sample"]
EXPLORATION: dict[str, ExplorationType] = {
    "mean": ExplorationType.DETERMINISTIC,
    "sample": ExplorationType.RANDOM,
}


@dataclass(frozen=True)
class ReturnMetrics:
    """Summary of episodes of a task that has no door."""

    episodes: int
    return_mean: float
    return_std: float
    length_mean: float


@dataclass(frozen=True)
class Rollouts:
    """Raw results of E episodes, at most T steps each."""

    returns: NDArray[np.float64]
    """Undiscounted return, shape [E]."""
    lengths: NDArray[np.int64]
    """Control steps, shape [E]."""
    hinge_angle: NDArray[np.float32] | None
    """Hinge angle after each step, shape [E, T], rad; NaN after the end; None without a door."""
    nearest: NDArray[np.float32] | None = None
    """Smallest distance between palm and handle, shape [E], m; None without a door."""
    widest_latch: NDArray[np.float32] | None = None
    """Largest latch angle, shape [E], rad; None without a door."""

    def metrics(self) -> DoorMetrics | ReturnMetrics:
        """The paper's columns, or just returns for other tasks."""
        if self.hinge_angle is not None:
            return summarise(
                self.hinge_angle,
                self.returns,
                self.lengths,
                nearest_m=self.nearest,
                widest_latch_rad=self.widest_latch,
            )
        return ReturnMetrics(
            episodes=len(self.returns),
            return_mean=float(self.returns.mean()),
            return_std=float(self.returns.std()),
            length_mean=float(self.lengths.mean()),
        )

    @classmethod
    def join(cls, waves: list[Rollouts]) -> Rollouts:
        """Puts waves of episodes behind one another."""
        angles = [wave.hinge_angle for wave in waves if wave.hinge_angle is not None]
        width = max((angle.shape[1] for angle in angles), default=0)
        padded = [
            np.pad(a, ((0, 0), (0, width - a.shape[1])), constant_values=np.nan) for a in angles
        ]
        return cls(
            returns=np.concatenate([wave.returns for wave in waves]),
            lengths=np.concatenate([wave.lengths for wave in waves]),
            hinge_angle=np.concatenate(padded) if padded else None,
            nearest=_joined([wave.nearest for wave in waves]),
            widest_latch=_joined([wave.widest_latch for wave in waves]),
        )


@dataclass(frozen=True)
class Evaluator:
    """Runs a policy on the same episodes every time.

    Episode i of the door stands where ``envs.door.starts.door_position(seed, i, 0)`` says, so the
    list does not depend on ``batch``; draws of actions do. Other tasks are seeded with ``seed`` and
    depend on it too.

    Args:
        env_name: As for ``envs.make_env``.
        episodes: How many.
        seed: Of the list.
        batch: Episodes stepped together.
        exploration: ``mean`` takes the policy's tanh(loc), ``sample`` draws.
        noise_scale: Of a draw: factor on the standard deviation before the tanh. Other than 1, the
            policy must be one of ``pipeline.networks.make_actor``.
        horizon: Control steps; None is the task's own.
        num_threads: Physics threads.
        device: Of the environment's tensors.

    Raises:
        ValueError: If ``exploration`` is unknown, ``noise_scale`` not positive or a count below 1.
    """

    env_name: str
    episodes: int
    seed: int
    batch: int = 250
    exploration: Exploration = "mean"
    noise_scale: float = 1.0
    horizon: int | None = None
    num_threads: int | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.exploration not in EXPLORATION:
            raise ValueError(
                f"evaluation.exploration must be one of {sorted(EXPLORATION)}, "
                f"got {self.exploration!r}."
            )
        require_noise_scale(self.noise_scale)
        if self.episodes < 1 or self.batch < 1:
            raise ValueError(
                f"evaluation.episodes and evaluation.batch must be at least 1, "
                f"got {self.episodes} and {self.batch}."
            )

    def run(self, policy: TensorDictModuleBase) -> Rollouts:
        """Runs all episodes; the random state of the caller is left as it was.

        Other tasks than the door run whole waves of ``batch`` and keep the first ``episodes``.
        """
        batch = min(self.batch, self.episodes)
        env = make_env(
            self.env_name,
            num_envs=batch,
            seed=self.seed,
            device=self.device,
            num_threads=self.num_threads,
            horizon=self.horizon,
        )
        try:
            with self.acting(policy) as acting:
                waves = [
                    run_wave(env, acting, door_starts(env, self.seed, first), self.episodes - first)
                    for first in range(0, self.episodes, batch)
                ]
        finally:
            env.close()
        return Rollouts.join(waves)

    @contextmanager
    def acting(self, policy: TensorDictModuleBase) -> Iterator[TensorDictModuleBase]:
        """The policy as it is judged: in evaluation mode, without gradients, with its noise.

        Draws start from ``seed``; the random state of the caller and the policy's mode come back.
        """
        was_training = policy.training
        policy.eval()
        try:
            with (
                kept_random_state(self.device),
                torch.no_grad(),
                one_torch_thread(),
                set_exploration_type(EXPLORATION[self.exploration]),
            ):
                torch.manual_seed(self.seed)
                yield policy if self.noise_scale == 1.0 else with_noise(policy, self.noise_scale)
        finally:
            policy.train(was_training)


def door_starts(env: EnvBase, seed: int, first: int) -> TensorDict | None:
    """What to reset ``env`` with so that its copies hold episodes ``first``, ``first + 1``, ...

    Returns:
        ``door_position`` [N, 3] (m) for the door; None for tasks whose start cannot be given.
    """
    if not isinstance(env, DoorEnv):
        return None
    positions = np.stack([door_position(seed, first + i, 0) for i in range(env.num_doors)])
    start = {"door_position": torch.as_tensor(positions)}
    return TensorDict(start, env.batch_size, device=env.device)


def run_wave(
    env: EnvBase,
    policy: TensorDictModuleBase,
    start: TensorDictBase | None,
    limit: int | None = None,
) -> Rollouts:
    """One episode in each copy of ``env`` [N]; the first ``limit`` of them are returned.

    Copies that are done are left alone (``_step`` mask) until the last one has finished.
    """
    td = env.reset(start)
    n = env.batch_size[0]
    active = torch.ones(n, 1, dtype=torch.bool, device=td.device)
    returns = torch.zeros(n, 1, dtype=torch.float64, device=td.device)
    lengths = torch.zeros(n, 1, dtype=torch.int64, device=td.device)
    angles: list[torch.Tensor] = []
    is_door = isinstance(env, DoorEnv)
    nearest = torch.full((n,), torch.inf, device=td.device)
    widest_latch = torch.full((n,), -torch.inf, device=td.device)
    while active.any():
        td = env.step(policy(td))
        after = td["next"]
        returns += after["reward"].double() * active
        lengths += active
        if "hinge_angle" in after.keys():  # noqa: SIM118 - a TensorDict is not a mapping
            angles.append(after["hinge_angle"].masked_fill(~active, torch.nan))
        if is_door:
            # A copy that is done stands still, so its extremes stay.
            observation = after["observation"]
            distance = torch.linalg.vector_norm(observation[:, PALM_TO_HANDLE], dim=-1)
            nearest = torch.minimum(nearest, distance)
            widest_latch = torch.maximum(widest_latch, observation[:, LATCH])
        active = active & ~after["done"]
        td = env.step_mdp(td)
        td["_step"] = active.squeeze(-1)
    kept = slice(0, limit)
    return Rollouts(
        returns=returns.squeeze(-1).cpu().numpy()[kept],
        lengths=lengths.squeeze(-1).cpu().numpy()[kept],
        hinge_angle=torch.cat(angles, dim=-1).cpu().numpy()[kept] if angles else None,
        nearest=nearest.cpu().numpy()[kept] if is_door else None,
        widest_latch=widest_latch.cpu().numpy()[kept] if is_door else None,
    )


def _joined(parts: list[NDArray[np.float32] | None]) -> NDArray[np.float32] | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if known else None


def as_scalars(metrics: DoorMetrics | ReturnMetrics) -> dict[str, Any]:
    """Plain values for JSON; intervals become two-element lists."""
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in asdict(metrics).items()
    }
