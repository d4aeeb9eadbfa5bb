"""What demonstration multiplication tries and what it keeps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MultiplyConfig:
    """How to multiply demonstrations.

    Attributes:
        target_episodes: stop when so many episodes are kept.
        max_attempts: give up after so many attempts.
        speed_low: slowest replay, relative to the recording.
        speed_high: fastest replay.
        speed_bins: equal parts of that range of speeds, each tried in proportion to the square of
            how often its source succeeds in it; 1 tries all speeds alike.
        noise_scale: largest standard deviation of the executed noise, in half-ranges of the
            actions; each attempt draws its own uniformly from [0, noise_scale].
        noise_correlation: of the noise between consecutive steps, in [0, 1).
        min_progress: keep episodes that get beyond it within the horizon, in the task's unit; None
            keeps those that succeed. Beyond success, it leaves the policies that copy them a
            margin.
        hold: keep only episodes that are where they were to get to at their last step too: what
            passes a goal in a swing is not shown.
        end_progress: play a kept episode no further than past it: what reads them makes no use of
            the rest, which costs as many simulator steps. None plays every episode to its horizon.
        balance: no source gives more than ``balance`` times its even share of the target.
        horizon: length of every episode in steps; None is the task's own.
        round_size: attempts simulated together. Part of the result: the choice of sources adapts
            from round to round.
        seed: of everything random.

    Raises:
        ValueError: a value is out of its range, or ``hold`` is asked of episodes that end early.
    """

    target_episodes: int = 350
    max_attempts: int = 4000
    speed_low: float = 1.1
    speed_high: float = 1.6
    speed_bins: int = 1
    noise_scale: float = 0.08
    noise_correlation: float = 0.9
    min_progress: float | None = None
    hold: bool = False
    end_progress: float | None = None
    balance: float = 1.5
    horizon: int | None = None
    round_size: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        requirements = {
            "target_episodes": self.target_episodes >= 1,
            "max_attempts": self.max_attempts >= 1,
            "speed_low": self.speed_low > 0,
            "speed_high": self.speed_high >= self.speed_low,
            "speed_bins": self.speed_bins >= 1,
            "noise_scale": self.noise_scale >= 0,
            "noise_correlation": 0 <= self.noise_correlation < 1,
            "balance": self.balance >= 1,
            "horizon": self.horizon is None or self.horizon >= 1,
            "round_size": self.round_size >= 1,
            "seed": self.seed >= 0,
            "end_progress": self.end_progress is None or not self.hold,
        }
        for name, holds in requirements.items():
            if not holds:
                raise ValueError(f"MultiplyConfig.{name} = {getattr(self, name)} is out of range")
