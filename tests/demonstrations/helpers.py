"""Small synthetic demonstrations, and the files that hold them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from envs.demonstrations import Episode, Provenance
from envs.door import task

DOOR = np.array([-0.25, 0.3, 0.3])


def raw_demo(seed: int = 0, steps: int = 12, observation_size: int = 39) -> dict[str, Any]:
    """One demonstration as the DAPG pickle spells it; smooth, near the door, deterministic."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(scale=0.01, size=(steps, observation_size)).cumsum(axis=0)
    observations[:, task.HANDLE] = DOOR + np.array([0.29, -0.15, -0.025])
    return {
        "observations": observations,
        "actions": rng.uniform(-1.2, 1.2, size=(steps, task.ACTION_SIZE)),
        "rewards": rng.normal(size=steps),
        "init_state_dict": {
            "qpos": np.zeros(30),
            "qvel": np.zeros(30),
            "door_body_pos": DOOR + 0.01 * seed,
        },
    }


def write_pickle(path: Path, content: object, protocol: int = 2) -> Path:
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    return path


def still_episode(seed: int = 0, steps: int = 10, **changes: Any) -> Episode:
    """A short valid episode of gentle random actions with observations that stay near zero."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(scale=0.05, size=(steps + 1, 38)).astype(np.float32)
    fields: dict[str, Any] = {
        "observations": observations,
        "actions": rng.uniform(-0.3, 0.3, size=(steps, 28)).astype(np.float32),
        "rewards": task.reward(observations[1:]),
        "terminated": np.zeros(steps, dtype=bool),
        "provenance": Provenance("synthetic", seed, "recorded", {"seed": seed}),
        "door_position": DOOR + 0.01 * seed,
    }
    return Episode(**(fields | changes))
