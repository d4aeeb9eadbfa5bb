"""Networks, batches and runs of the pipeline tests: small enough to reason about."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from configs import compose
from envs.adroit.simulator import HandSimulator
from envs.adroit.starts import placement_of
from envs.demonstrations import Episode, Provenance, write_recording
from envs.door import task
from envs.door.hand import DOOR, DOOR_POSITION
from losses import BCSACLoss
from pipeline.build import build_run
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.recipe import Recipe
from pipeline.trainer import Run

OBSERVATION_SIZE = 3
ACTION_SIZE = 2

TINY = (
    "env.num_threads=1",
    "env.horizon=10",
    "collector.total_frames=40",
    "collector.frames_per_batch=20",
    "bc.updates=100",
    "bc.batch_size=8",
    "sampler.batch_size=8",
    "growth.bc_model_episodes=2",
    "evaluation.interval=1000",
    "evaluation.interval_episodes=1",
    "optim.actor_delay=0",
)
"""Overrides of the smoke preset under which a run takes a fraction of a second."""


def tiny_config(variant: str, folder: Path, demos: Path, *overrides: str) -> Recipe:
    """A run of 40 frames below ``folder``; see :func:`built`."""
    return compose(
        f"variant={variant}",
        "preset=smoke",
        *TINY,
        f"cache_dir='{folder / 'cache'}'",
        f"demos.source='{demos}'",
        *overrides,
    )


def where(recipe: Recipe) -> Path:
    """The run directory of a recipe of :func:`tiny_config`: beside its cache."""
    return Path(recipe.cache_dir).parent / recipe.variant


def built(recipe: Recipe, **options: Any) -> Run:
    """The run of a recipe, in its directory."""
    return build_run(recipe, where(recipe), **options)


def write_demos(path: Path, episodes: int = 2, steps: int = 12) -> Path:
    """A recording of short episodes of gentle random actions, as the simulator played them."""
    rng = np.random.default_rng(0)
    doors = np.array([placement_of(DOOR, 1, i, 0)[DOOR_POSITION] for i in range(episodes)])
    simulator = HandSimulator(DOOR, episodes, num_threads=1)
    simulator.start({DOOR_POSITION: doors})
    observations = [simulator.observation().copy()]
    actions = rng.uniform(-0.3, 0.3, size=(steps, episodes, task.ACTION_SIZE)).astype(np.float32)
    observations += [simulator.step(action).copy() for action in actions]
    simulator.close()
    seen = np.stack(observations, axis=1)
    recorded = [
        Episode(
            observations=seen[i],
            actions=actions[:, i],
            rewards=task.reward(seen[i, 1:]),
            terminated=np.zeros(steps, dtype=bool),
            provenance=Provenance("synthetic", i, "recorded"),
            start={"door_position": doors[i], "qpos": np.zeros(30), "qvel": np.zeros(30)},
            success=task.success(seen[i]),
            progress=task.hinge_angle(seen[i]),
        )
        for i in range(episodes)
    ]
    write_recording(path, recorded, {"made_by": "the tests"})
    return path


def make_loss(**options: Any) -> BCSACLoss:
    """BCSACLoss over the pipeline's own networks."""
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    critic = BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [8], 2)
    return BCSACLoss(actor, critic, target_entropy=-float(ACTION_SIZE), **options)


def make_batch(rows: int, demo_rows: int | None = None) -> TensorDict:
    """``rows`` transitions of which the last ``demo_rows`` are marked; None: no marks."""
    batch = TensorDict(
        {
            "observation": torch.randn(rows, OBSERVATION_SIZE),
            "action": torch.rand(rows, ACTION_SIZE) * 1.6 - 0.8,
            "steps_to_next_obs": torch.ones(rows, 1, dtype=torch.int64),
            "next": {
                "observation": torch.randn(rows, OBSERVATION_SIZE),
                "reward": torch.randn(rows, 1),
                "terminated": torch.zeros(rows, 1, dtype=torch.bool),
            },
        },
        [rows],
    )
    if demo_rows is not None:
        batch["is_demo"] = torch.arange(rows).unsqueeze(-1) >= rows - demo_rows
    return batch


def trajectory(
    rewards: list[float],
    *,
    terminated: Sequence[int] = (),
    truncated: Sequence[int] = (),
    tag: float = 0.0,
) -> TensorDict:
    """Transitions [T] whose observation at time t is ``tag + t``; episodes end where listed."""
    steps = len(rewards)
    time = torch.arange(steps + 1, dtype=torch.float32).unsqueeze(-1) + tag
    ends = torch.zeros(2, steps, 1, dtype=torch.bool)
    for kind, at in enumerate((terminated, truncated)):
        ends[kind, list(at)] = True
    return TensorDict(
        {
            "observation": time[:-1].clone(),
            "action": torch.zeros(steps, 1),
            "next": {
                "observation": time[1:].clone(),
                "reward": torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1),
                "terminated": ends[0],
                "truncated": ends[1],
                "done": ends[0] | ends[1],
            },
        },
        [steps],
    )


def tagged_rows(tag: float, count: int) -> TensorDict:
    """``count`` rows that can be told from others: every observation and reward is ``tag``."""
    return TensorDict(
        {
            "observation": torch.full((count, OBSERVATION_SIZE), tag),
            "action": torch.zeros(count, ACTION_SIZE),
            "steps_to_next_obs": torch.ones(count, 1, dtype=torch.int64),
            "next": {
                "observation": torch.full((count, OBSERVATION_SIZE), tag),
                "reward": torch.full((count, 1), tag),
                "terminated": torch.zeros(count, 1, dtype=torch.bool),
            },
        },
        [count],
    )


def parameters_of(module: torch.nn.Module) -> list[torch.Tensor]:
    """Copies of all parameters."""
    return [parameter.detach().clone() for parameter in module.parameters()]


def same(left: list[torch.Tensor], right: list[torch.Tensor]) -> bool:
    """Whether two lists of tensors are equal bit for bit."""
    return all(torch.equal(a, b) for a, b in zip(left, right, strict=True))
