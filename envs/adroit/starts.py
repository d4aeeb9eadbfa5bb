"""Where things stand at the start of an episode, drawn reproducibly for each copy."""

from __future__ import annotations

import numpy as np

from envs.adroit.hand import HandTask, Placement


def episode_rng(seed: int, copy: int, episode: int) -> np.random.Generator:
    """Source of randomness of episode `episode` (from 0) of copy `copy`.

    A stream per copy that is addressed by number instead of being stored: what a copy sees depends
    neither on how many there are nor on when the others reset, and resuming a run needs the seed
    and the episode counters only.

    Raises:
        ValueError: If a number is negative.
    """
    if min(seed, copy, episode) < 0:
        raise ValueError(f"seed, copy and episode must be >= 0, got {seed}, {copy}, {episode}")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(copy, episode)))


def placement_of(task: HandTask, seed: int, copy: int, episode: int) -> Placement:
    """Where things stand in episode `episode` of copy `copy`, shape [k] by name."""
    return task.draw(episode_rng(seed, copy, episode))
