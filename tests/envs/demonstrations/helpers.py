"""Small synthetic demonstrations, and the files that hold them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from envs.demonstrations import (
    DemonstrationSet,
    DemoOptions,
    Episode,
    Provenance,
    load_demonstrations,
)
from envs.door import task
from envs.door.definition import TASK
from envs.door.demos import SCHEMA
from envs.door.hand import DOOR_POSITION

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
    """A short valid door episode of gentle random actions whose observations stay near zero.

    Success and progress are those of the observations; a start key of None is left out.
    """
    rng = np.random.default_rng(seed)
    observations = rng.normal(scale=0.05, size=(steps + 1, 38)).astype(np.float32)
    keys = {key.name for key in SCHEMA.start}
    start = {DOOR_POSITION: DOOR + 0.01 * seed} | {k: changes.pop(k) for k in keys & changes.keys()}
    fields: dict[str, Any] = {
        "observations": observations,
        "actions": rng.uniform(-0.3, 0.3, size=(steps, 28)).astype(np.float32),
        "terminated": np.zeros(steps, dtype=bool),
        "provenance": Provenance("synthetic", seed, "recorded", {"seed": seed}),
        "start": {key: value for key, value in start.items() if value is not None},
    } | changes
    seen = fields["observations"]
    told = {
        "rewards": task.reward(seen[1:]),
        "success": task.success(seen),
        "progress": task.hinge_angle(seen),
    }
    return Episode(**(told | fields))


def door_of(episode: Episode) -> np.ndarray:
    """Where the episode's door stands, [3], m."""
    return episode.start[DOOR_POSITION]


def load_door(
    spec: str | Path, *, cache_dir: Path | None = None, **options: Any
) -> DemonstrationSet:
    """Demonstrations of the door."""
    chosen = DemoOptions(**options)
    return load_demonstrations(spec, TASK, chosen, num_threads=1, cache_dir=cache_dir)
