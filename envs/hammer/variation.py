"""How the hammer's demonstrations are varied: the palm moves along with the board."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.guide import ArmGuide
from envs.adroit.hand import Placement
from envs.adroit.multiplication import HandVariation
from envs.adroit.varying import Guided, Varying, first
from envs.demonstrations.episode import Episode
from envs.hammer import task
from envs.hammer.demos import SCHEMA
from envs.hammer.hand import BOARD_POSITION, HAMMER

GUIDE: Final = ArmGuide(arm=slice(0, 2), joints=task.HAND_QPOS, observed=task.HAND_QPOS)


def _offset(source: Placement, new: Placement) -> NDArray[np.float64]:
    return new[BOARD_POSITION] - source[BOARD_POSITION]


def follow(episode: Episode) -> tuple[NDArray[np.float64]]:
    """How much of the board's offset the palm has made at each step, [T].

    The hammer lies where it always does: the palm leaves its path where it lifts the hammer, and
    has left it where the nail first gives way.
    """
    lifted = first(episode.observations[1:, task.HAMMER][:, 2] > task.LIFTED)
    struck = begins(episode)
    if lifted is None or struck is None or struck <= lifted:
        return (np.zeros(episode.length),)
    return (np.interp(np.arange(episode.length), [lifted, struck], [0.0, 1.0]),)


def begins(episode: Episode) -> int | None:
    """Step in which the nail gives way; None if it never does."""
    return first(task.driven(episode.observations[1:]) > task.MOVED)


VARYING: Final = Varying(
    name="HammerVariation",
    task=HAMMER,
    schema=SCHEMA,
    apart=lambda source, new: float(np.linalg.norm(_offset(source, new))),
    apart_key="board_offset_m",
    scale_key="height_scale_m",
    progress="how far the nail is driven in m",
    guided=Guided(GUIDE, lambda source, new: (_offset(source, new),), follow),
    begins=begins,
    under_way=lambda observations, _: task.driven(observations) > task.MOVED,
    patience=30,
)
VARY: Final = HandVariation(VARYING, scale=0.03)
