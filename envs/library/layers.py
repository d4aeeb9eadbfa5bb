"""What an environment is wrapped in."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import gymnasium
from gymnasium.wrappers import TimeLimit

Env = gymnasium.Env[Any, Any]


def layers(env: Env) -> Iterator[Env]:
    """The environment and what it is wrapped around, from the outside in."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env
    yield env


def time_limit(env: Env) -> int | None:
    """Steps after which ``env`` truncates an episode, as far as it says so; None if it does not."""
    limits = [layer._max_episode_steps for layer in layers(env) if isinstance(layer, TimeLimit)]
    # dm_control's own: an episode ends at the first whole step that is not below it.
    suite = getattr(env.unwrapped, "_step_limit", math.inf)
    if math.isfinite(suite):
        limits.append(math.ceil(suite))
    return min(limits, default=None)
