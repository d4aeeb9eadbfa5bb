"""What demonstration multiplication tries and what it keeps."""

from __future__ import annotations

from dataclasses import dataclass

from envs.door import task


@dataclass(frozen=True)
class MultiplyConfig:
    """How to multiply demonstrations.

    Attributes:
        target_episodes: stop when so many episodes are kept.
        max_attempts: give up after so many attempts.
        speed_low: slowest replay, relative to the recording.
        speed_high: fastest replay. At twice the human speed nothing succeeds.
        position_scale_m: a source is chosen with weight exp(-(d / scale)^2), d being the distance
            in metres between its door and the new one.
        guide_arm: shift the palm's path by the offset between the two doors (`ArmGuide`).
        noise_scale: largest standard deviation of the executed noise, in half-ranges of the joints;
            each attempt draws its own uniformly from [0, noise_scale].
        noise_correlation: of the noise between consecutive steps, in [0, 1).
        min_angle: keep episodes whose hinge passes this angle (rad) within the horizon. Beyond
            1.35, success, it leaves the policies that copy them a margin.
        balance: no source gives more than ``balance`` times its even share of the target.
        horizon: length of every episode in steps.
        round_size: attempts simulated together. Part of the result: the choice of sources adapts
            from round to round.
        seed: of everything random.

    Raises:
        ValueError: a value is out of its range.
    """

    target_episodes: int = 350
    max_attempts: int = 4000
    speed_low: float = 1.1
    speed_high: float = 1.6
    position_scale_m: float = 0.08
    guide_arm: bool = True
    noise_scale: float = 0.08
    noise_correlation: float = 0.9
    min_angle: float = task.SUCCESS_ANGLE
    balance: float = 1.5
    horizon: int = task.HORIZON
    round_size: int = 128
    seed: int = 0

    def __post_init__(self) -> None:
        requirements = {
            "target_episodes": self.target_episodes >= 1,
            "max_attempts": self.max_attempts >= 1,
            "speed_low": self.speed_low > 0,
            "speed_high": self.speed_high >= self.speed_low,
            "position_scale_m": self.position_scale_m > 0,
            "noise_scale": self.noise_scale >= 0,
            "noise_correlation": 0 <= self.noise_correlation < 1,
            "min_angle": self.min_angle < task.FULLY_OPEN,
            "balance": self.balance >= 1,
            "horizon": self.horizon >= 1,
            "round_size": self.round_size >= 1,
            "seed": self.seed >= 0,
        }
        for name, holds in requirements.items():
            if not holds:
                raise ValueError(f"MultiplyConfig.{name} = {getattr(self, name)} is out of range")
