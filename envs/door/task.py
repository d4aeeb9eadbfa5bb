"""What the door task is: observation layout, reward, termination. NumPy only, no simulator.

Every quantity is a pure function of the *observation*, so the simulator, the relabelling of
demonstrations and the evaluation cannot disagree about it. Functions take observations of shape
``[..., 38]`` (more columns are allowed and ignored: DAPG's and Minari's files carry a 39th,
``door_open``) and keep the leading shape.

Reference: the paper's door-v1 (section IV-A, "R = ..."), RoboHive's hand manipulation suite.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

OBSERVATION_SIZE: Final = 38
"""Entries of one observation (float32)."""
ACTION_SIZE: Final = 28
"""Entries of one action, each in [-1, 1]: normalised joint position targets."""
STATE_SIZE: Final = 30
"""Joints: arm (4), hand (24), hinge, latch."""
HORIZON: Final = 200
"""Control steps after which an episode is truncated (2 s at 100 Hz)."""

HAND_QPOS: Final = slice(0, 27)
"""Arm, wrist and finger joint positions, rad. The arm's sliding joint ARTz is not observed."""
WRIST_AND_FINGERS: Final = slice(3, 27)
"""Of these the joints of wrist and fingers, which make up a posture whatever stands where, rad."""
LATCH: Final = 27
"""Latch angle, rad."""
HINGE: Final = 28
"""Door hinge angle, rad: 0 closed, 1.57 fully open."""
PALM: Final = slice(29, 32)
"""Palm (grasp site) position in the world, m."""
HANDLE: Final = slice(32, 35)
"""Door handle position in the world, m."""
PALM_TO_HANDLE: Final = slice(35, 38)
"""Palm minus handle position, m."""

OPEN_THRESHOLDS: Final = (0.2, 1.0, 1.35)
"""Hinge angles (rad) above which a bonus is paid at every step."""
OPEN_BONUSES: Final = (2.0, 8.0, 10.0)
"""Reward per step for each threshold; they add up."""
FULLY_OPEN: Final = 1.57
"""Hinge angle (rad) that the quadratic reward term pulls towards."""
SUCCESS_ANGLE: Final = OPEN_THRESHOLDS[-1]
"""Hinge angle (rad) above which the door counts as open."""
MAX_REACH: Final = 1.0
"""Palm-handle distance (m) beyond which the suite ends the episode."""

DOOR_POSITION_LOW: Final = (-0.3, 0.25, 0.252)
"""Lower corner (m) of the box from which the door frame's position is drawn at reset."""
DOOR_POSITION_HIGH: Final = (-0.2, 0.35, 0.35)
"""Upper corner (m) of that box."""

Floats = NDArray[np.floating]


def _checked(observation: Floats) -> Floats:
    observation = np.asarray(observation)
    if observation.ndim == 0 or observation.shape[-1] < OBSERVATION_SIZE:
        raise ValueError(
            f"a door observation has at least {OBSERVATION_SIZE} entries in its last dimension, "
            f"got shape {observation.shape}"
        )
    return observation


def hinge_angle(observation: Floats) -> Floats:
    """Door hinge angle in rad, shape ``[...]``.

    Args:
        observation: Observations, shape ``[..., >=38]``.

    Raises:
        ValueError: If the last dimension is too short. The same holds for every function here.
    """
    return _checked(observation)[..., HINGE]


def palm_handle_distance(observation: Floats) -> Floats:
    """Distance between palm and handle in m, shape ``[...]``, from observations ``[..., >=38]``."""
    return np.linalg.norm(_checked(observation)[..., PALM_TO_HANDLE], axis=-1)


def reward(next_observation: Floats) -> NDArray[np.float32]:
    """Reward of arriving at `next_observation`, float32 of shape ``[...]``.

    Paper, section IV-A::

        R = -0.1 |palm - handle| - 0.1 (hinge - 1.57)^2
            + 2 [hinge > 0.2] + 8 [hinge > 1.0] + 10 [hinge > 1.35]

    Evaluated in float64, so that a float32 observation gives the same reward wherever it is read.

    Args:
        next_observation: Observations *after* the action, shape ``[..., >=38]``.
    """
    hinge = hinge_angle(next_observation).astype(np.float64)
    reach = palm_handle_distance(next_observation.astype(np.float64))
    value = -0.1 * reach - 0.1 * (hinge - FULLY_OPEN) ** 2
    for threshold, bonus in zip(OPEN_THRESHOLDS, OPEN_BONUSES, strict=True):
        value = value + bonus * (hinge > threshold)
    return value.astype(np.float32)


def terminated(next_observation: Floats) -> NDArray[np.bool_]:
    """Whether the hand has left the door (palm-handle distance > 1 m), bool of shape ``[...]``.

    This is the only terminal state. The end of the 200 steps is a truncation: bootstrap through it.
    """
    return palm_handle_distance(next_observation) > MAX_REACH


def success(observation: Floats) -> NDArray[np.bool_]:
    """Whether the door is open (hinge > 1.35 rad), bool of shape ``[...]``."""
    return hinge_angle(observation) > SUCCESS_ANGLE


def stage(episode_observations: Floats) -> NDArray[np.int64]:
    """How many of `OPEN_THRESHOLDS` an episode passed at any time: 0 (closed) to 3 (open).

    Args:
        episode_observations: Observations in time order, shape ``[..., T, >=38]`` with T >= 1.

    Returns:
        Integers of shape ``[...]``.
    """
    widest = hinge_angle(episode_observations).max(axis=-1)
    return np.searchsorted(np.asarray(OPEN_THRESHOLDS), widest, side="left")
