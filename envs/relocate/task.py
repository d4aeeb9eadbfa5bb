"""What the relocate task is: observation layout, reward, success. NumPy only, no simulator.

Reference: the suite's relocate-v0 (Rajeswaran et al., 2018, arXiv:1709.10087; gymnasium-robotics'
AdroitHandRelocate-v1). Lengths in m, angles in rad.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.judging import norm

OBSERVATION_SIZE: Final = 39
"""Entries of one observation (float32)."""
ACTION_SIZE: Final = 30
"""Entries of one action, each in [-1, 1]: normalised joint position targets."""
STATE_SIZE: Final = 36
"""Joints: arm (6), hand (24), ball (6)."""
HORIZON: Final = 200
"""Control steps after which an episode is truncated (2 s at 100 Hz)."""

HAND_QPOS: Final = slice(0, 30)
"""Arm, wrist and finger joint positions."""
WRIST_AND_FINGERS: Final = slice(6, 30)
"""Of these the joints of wrist and fingers, which make up a posture whatever stands where, rad."""
BALL_TO_PALM: Final = slice(30, 33)
"""Palm (grasp site) minus ball position."""
TARGET_TO_PALM: Final = slice(33, 36)
"""Palm minus target position."""
TARGET_TO_BALL: Final = slice(36, 39)
"""Ball minus target position."""

LIFTED: Final = 0.04
"""Height above which the ball counts as lifted; it rests at 0.035."""
REACH: Final = 0.15
"""Distance between palm and ball beyond which no finger touches it."""
CLOSE: Final = 0.1
"""Distance to the target below which the task is accomplished."""
VERY_CLOSE: Final = 0.05
"""Distance below which another bonus is paid."""

BALL_LOW: Final = (-0.15, -0.15)
"""Lower corner of the rectangle from which the ball's x and y are drawn at reset."""
BALL_HIGH: Final = (0.15, 0.3)
"""Its upper corner."""
BALL_HEIGHT: Final = 0.035
"""Where it rests."""
TARGET_LOW: Final = (-0.2, -0.2, 0.15)
"""Lower corner of the box from which the target is drawn at reset."""
TARGET_HIGH: Final = (0.2, 0.2, 0.35)
"""Its upper corner."""

Floats = NDArray[np.floating]


def reward(observation: Floats, ball_height: Floats) -> NDArray[np.float32]:
    """Reward of a state, float32 of shape ``[...]``.

    ::

        R = -0.1 |palm - ball| + [lifted] (1 - 0.5 |palm - target| - 0.5 |ball - target|)
            + 10 [|ball - target| < 0.1] + 20 [|ball - target| < 0.05]

    Deviation: gymnasium-robotics up to 1.4.2 has the first term with the opposite sign, which pays
    for keeping away from the ball.

    Args:
        observation: Observations, shape ``[..., 39]``.
        ball_height: Heights of the ball, shape ``[...]``, which no observation shows.
    """
    seen = np.asarray(observation, dtype=np.float64)
    to_target = norm(seen[..., TARGET_TO_BALL])
    carried = 1 - 0.5 * norm(seen[..., TARGET_TO_PALM]) - 0.5 * to_target
    value = -0.1 * norm(seen[..., BALL_TO_PALM]) + (ball_height > LIFTED) * carried
    return (value + 10 * (to_target < CLOSE) + 20 * (to_target < VERY_CLOSE)).astype(np.float32)


def success(observation: Floats) -> NDArray[np.bool_]:
    """Whether the ball is within 0.1 of its target, bool of shape ``[...]``, from [..., 39]."""
    return norm(np.asarray(observation, dtype=np.float64)[..., TARGET_TO_BALL]) < CLOSE


def nearness(observation: Floats) -> NDArray[np.float64]:
    """Progress: minus the ball's distance from its target, shape ``[...]``, from [..., 39]."""
    return -norm(np.asarray(observation, dtype=np.float64)[..., TARGET_TO_BALL])
