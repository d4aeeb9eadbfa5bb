"""How far a run goes: how much experience it collects, in which portions, or how long it clones."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic.dataclasses import dataclass as settings

from pipeline.settings import STRICT, Count, NotNegative


@settings(frozen=True, kw_only=True, config=STRICT)
class CollectorSettings:
    """How much experience, collected in which portions."""

    total_frames: Count = 100_000
    frames_per_batch: Count = 1
    random_frames: NotNegative = 10_000  # seed steps with uniformly random actions
    greedy_envs: NotNegative = 0  # of env.num_envs: those that act with the mean action


@dataclass(frozen=True)
class Budget:
    """How far a run goes, in what its trainer counts and its checkpoints are numbered by.

    Attributes:
        key: of the setting.
        total: its value.
        unit: what is counted, in words.
        in_environment: whether these are frames of an environment. A run that clones alone has
            none, and its trainer counts updates under that name.
    """

    key: str
    total: int
    unit: str
    in_environment: bool

    def frames(self, counted: int) -> int:
        """Frames of an environment among what the trainer counted."""
        return counted if self.in_environment else 0
