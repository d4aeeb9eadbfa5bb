"""What the hammer task is: observation layout, reward, success. NumPy only, no simulator.

Reference: the suite's hammer-v0 (Rajeswaran et al., 2018, arXiv:1709.10087; gymnasium-robotics'
AdroitHandHammer-v1). Lengths in m, angles in rad.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy  # `spatial` takes a second to load, and scipy does it where it is first used
from numpy.typing import NDArray

from envs.adroit.judging import norm

OBSERVATION_SIZE: Final = 46
"""Entries of one observation (float32)."""
ACTION_SIZE: Final = 26
"""Entries of one action, each in [-1, 1]: normalised joint position targets."""
STATE_SIZE: Final = 33
"""Joints: arm (2), hand (24), nail, hammer (6)."""
HORIZON: Final = 200
"""Control steps after which an episode is truncated (2 s at 100 Hz)."""

HAND_QPOS: Final = slice(0, 26)
"""Arm, wrist and finger joint positions."""
WRIST_AND_FINGERS: Final = slice(2, 26)
"""Of these the joints of wrist and fingers, which make up a posture whatever stands where, rad."""
NAIL: Final = 26
"""How far the nail has been driven: -0.01 at first, 0.09 at most."""
HAMMER_VELOCITY: Final = slice(27, 33)
"""Velocities of the hammer's joints, clipped to [-1, 1]."""
PALM: Final = slice(33, 36)
"""Palm (grasp site) position in the world."""
HAMMER: Final = slice(36, 39)
"""Hammer position in the world (the middle of its handle)."""
HAMMER_ANGLES: Final = slice(39, 42)
"""Its orientation as Euler angles."""
NAIL_HEAD: Final = slice(42, 45)
"""Position of the nail's head in the world."""
IMPACT: Final = 45
"""Force on the nail's head (N), clipped to [-1, 1]."""

NAIL_LENGTH: Final = 0.091
"""Distance between the nail's head and its goal with `NAIL` at 0."""
CLOSE: Final = 0.02
"""Distance between the nail's head and its goal below which a bonus is paid."""
DRIVEN: Final = 0.01
"""Distance below which the nail counts as driven in."""
MOVED: Final = 0.01
"""How far the nail has been driven when it counts as hit."""
LIFTED: Final = 0.04
"""Height above which the hammer counts as lifted."""
BOARD_HEIGHT: Final = (0.1, 0.25)
"""Range from which the board's height is drawn at reset."""
#: From the middle of the hammer's handle to its striking face, along the hammer's own axes.
HEAD_OFFSET: Final = (-0.2, 0.0, -0.04)

Floats = NDArray[np.floating]


def reward(
    palm: Floats,
    hammer: Floats,
    head: Floats,
    nail: Floats,
    to_goal: Floats,
    speed: Floats | float = 0.0,
) -> NDArray[np.float32]:
    """Reward of a state, float32 of shape ``[...]``.

    ::

        R = -0.1 |palm - hammer| - |head - nail| - 10 |nail - goal| - 0.01 |qvel|
            + 2 [hammer and head lifted] + 25 [|nail - goal| < 0.02] + 75 [|nail - goal| < 0.01]

    Deviation: gymnasium-robotics up to 1.4.2 has the first term with the opposite sign, which pays
    for keeping away from the hammer.

    Args:
        palm: Palm positions, shape ``[..., 3]``.
        hammer: Hammer positions, shape ``[..., 3]``.
        head: Positions of the hammer's striking face, shape ``[..., 3]``.
        nail: Positions of the nail's head, shape ``[..., 3]``.
        to_goal: Distances between the nail's head and its goal, shape ``[...]``.
        speed: Norms of the joint velocities, shape ``[...]``.
    """
    value = -0.1 * norm(palm - hammer) - norm(head - nail) - 10 * to_goal - 0.01 * speed
    lifted = (hammer[..., 2] > LIFTED) & (head[..., 2] > LIFTED)
    value = value + 2 * lifted + 25 * (to_goal < CLOSE) + 75 * (to_goal < DRIVEN)
    return value.astype(np.float32)


def observed_reward(next_observation: Floats) -> NDArray[np.float32]:
    """`reward` as far as an observation shows it: without the velocities.

    For recordings that are not played again.

    Args:
        next_observation: Observations *after* the action, shape ``[..., 46]``.
    """
    seen = np.asarray(next_observation, dtype=np.float64)
    hammer, nail = seen[..., HAMMER], seen[..., NAIL_HEAD]
    head = hammer + head_offset(seen[..., HAMMER_ANGLES])
    return reward(seen[..., PALM], hammer, head, nail, goal_distance(seen))


def goal_distance(observation: Floats) -> NDArray[np.float64]:
    """Distance between the nail's head and its goal, shape ``[...]``, from ``[..., 46]``."""
    return np.abs(NAIL_LENGTH - np.asarray(observation, dtype=np.float64)[..., NAIL])


def success(observation: Floats) -> NDArray[np.bool_]:
    """Whether the nail is driven in, bool of shape ``[...]``, from ``[..., 46]``."""
    return goal_distance(observation) < DRIVEN


def driven(observation: Floats) -> Floats:
    """Progress: how far the nail has been driven, shape ``[...]``, from ``[..., 46]``."""
    return np.asarray(observation)[..., NAIL]


def euler_angles(quaternion: Floats) -> NDArray[np.float64]:
    """Euler angles ``[..., 3]`` of unit quaternions ``[..., 4]`` (w, x, y, z).

    The convention of DAPG's observations (mujoco-py's and gymnasium-robotics' ``quat2euler``), in
    which a rotation is that about x, then y, then z, each about axes that turn along. SciPy's "XYZ"
    is the same but where the hammer points straight up or down: there it keeps the first angle.
    """
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=np.float64), -1, 0)
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    sx, sy, sz = x * scale, y * scale, z * scale
    upper = np.stack([1.0 - (y * sy + z * sz), x * sy - w * sz, x * sz + w * sy])
    across, along = y * sz - w * sx, 1.0 - (x * sx + y * sy)
    cosine = np.sqrt(along * along + across * across)
    # Pointing straight up or down, two of the angles turn about the same axis: one stays 0.
    fixed = cosine <= 4 * np.finfo(np.float64).eps
    yaw = np.where(
        fixed,
        -np.arctan2(-(x * sy + w * sz), 1.0 - (x * sx + z * sz)),
        -np.arctan2(upper[1], upper[0]),
    )
    pitch = -np.arctan2(-upper[2], cosine)
    return np.stack([np.where(fixed, 0.0, -np.arctan2(across, along)), pitch, yaw], -1)


def head_offset(angles: Floats) -> NDArray[np.float64]:
    """From the middle of the hammer's handle to its striking face, in the world, ``[..., 3]``.

    Args:
        angles: The hammer's, as `euler_angles` gives them, ``[..., 3]``.
    """
    turned = scipy.spatial.transform.Rotation.from_euler("XYZ", np.reshape(angles, (-1, 3)))
    return turned.apply(HEAD_OFFSET).reshape(np.shape(angles))
