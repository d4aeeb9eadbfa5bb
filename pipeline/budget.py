"""How much experience a run collects, and in which portions."""

from __future__ import annotations

from pydantic.dataclasses import dataclass as settings

from pipeline.settings import STRICT, Count, NotNegative


@settings(frozen=True, kw_only=True, config=STRICT)
class CollectorSettings:
    """How much experience, collected in which portions."""

    total_frames: Count = 100_000
    frames_per_batch: Count = 1
    random_frames: NotNegative = 10_000  # seed steps with uniformly random actions
    greedy_envs: NotNegative = 0  # of env.num_envs: those that act with the mean action
