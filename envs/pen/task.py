"""What the pen task is: observation layout, reward, success. NumPy only, no simulator.

Every quantity is a pure function of the *observation* ``[..., 45]``. Reference: the suite's pen-v0
(Rajeswaran et al., 2018, arXiv:1709.10087; gymnasium-robotics' AdroitHandPen-v1).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.judging import norm

OBSERVATION_SIZE: Final = 45
"""Entries of one observation (float32)."""
ACTION_SIZE: Final = 24
"""Entries of one action, each in [-1, 1]: normalised joint position targets."""
STATE_SIZE: Final = 30
"""Joints: hand (24), pen (6)."""
HORIZON: Final = 100
"""Control steps after which an episode is truncated (1 s at 100 Hz), as DAPG's and RLPD's have it;
gymnasium-robotics plays 200."""

HAND_QPOS: Final = slice(0, 24)
"""Wrist and finger joint positions, rad."""
PEN: Final = slice(24, 27)
"""Pen position in the world, m."""
PEN_VELOCITY: Final = slice(27, 33)
"""Velocities of the pen's joints, m/s and rad/s."""
DIRECTION: Final = slice(33, 36)
"""Where the pen points, a unit vector."""
ASKED: Final = slice(36, 39)
"""Where it is to point, a unit vector."""
OFF_CENTRE: Final = slice(39, 42)
"""Pen position minus the place above the palm where it belongs, m."""
DIRECTION_ERROR: Final = slice(42, 45)
"""`DIRECTION` minus `ASKED`."""

ASKED_ANGLE: Final = 1.0
"""Largest angle (rad) about x, then about the y that has turned along, from upright to the asked
orientation: both are drawn at reset, from minus this to this."""
PEN_LENGTH: Final = 0.13
"""Between the two ends, m."""
HELD: Final = 0.075
"""Distance (m) from its place within which the pen counts as held."""
DROPPED: Final = 0.075
"""Height (m) below which it counts as dropped."""
ALIGNMENTS: Final = (0.9, 0.95)
"""Cosines of the angle to the asked direction above which a bonus is paid while it is held."""
ALIGNMENT_BONUSES: Final = (10.0, 50.0)
"""Reward per step for each; they add up."""

Floats = NDArray[np.floating]


def alignment(observation: Floats) -> NDArray[np.float64]:
    """Progress: cosine of the angle between pen and asked direction, ``[...]``, from [..., 45]."""
    seen = np.asarray(observation, dtype=np.float64)
    return np.einsum("...i,...i->...", seen[..., DIRECTION], seen[..., ASKED])


def held(observation: Floats) -> NDArray[np.bool_]:
    """Whether the pen is within 0.075 m of its place, ``[...]``, from [..., 45]."""
    return _off_centre(observation) < HELD


def success(observation: Floats) -> NDArray[np.bool_]:
    """Whether the pen is held and points as asked (within 18 degrees), ``[...]``."""
    return held(observation) & (alignment(observation) > ALIGNMENTS[-1])


def reward(next_observation: Floats) -> NDArray[np.float32]:
    """Reward of arriving at `next_observation` [..., 45], float32 of shape ``[...]``.

    ::

        R = -|pen - place| + cos + 10 [held, cos > 0.9] + 50 [held, cos > 0.95] - 5 [dropped]
    """
    cosine, in_place = alignment(next_observation), held(next_observation)
    value = cosine - _off_centre(next_observation)
    for threshold, bonus in zip(ALIGNMENTS, ALIGNMENT_BONUSES, strict=True):
        value = value + bonus * (in_place & (cosine > threshold))
    height = np.asarray(next_observation)[..., PEN][..., 2]
    return (value - 5 * (height < DROPPED)).astype(np.float32)


def _off_centre(observation: Floats) -> NDArray[np.float64]:
    return norm(np.asarray(observation, dtype=np.float64)[..., OFF_CENTRE])
