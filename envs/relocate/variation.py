"""How relocate's demonstrations are varied: the palm moves along with the ball, then the target."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.guide import ArmGuide
from envs.adroit.hand import Placement
from envs.adroit.multiplication import HandVariation
from envs.adroit.varying import Guided, Varying, first
from envs.demonstrations.episode import Episode
from envs.relocate import task
from envs.relocate.demos import SCHEMA
from envs.relocate.hand import BALL_POSITION, RELOCATE, TARGET_POSITION

GUIDE: Final = ArmGuide(arm=slice(0, 6), joints=task.HAND_QPOS, observed=task.HAND_QPOS)


def offsets(source: Placement, new: Placement) -> tuple[NDArray[np.float64], ...]:
    """How far the ball and its target have moved, [3] each, m."""
    return tuple(new[name] - source[name] for name in (BALL_POSITION, TARGET_POSITION))


def follow(episode: Episode) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much of the ball's and of the target's offset the palm has made at each step, [T] each.

    All of the ball's from where a finger could touch it until it is lifted; then the target takes
    over, wholly when the ball has come to it.
    """
    seen, steps = episode.observations[1:], np.arange(episode.length)
    near = first(np.linalg.norm(seen[:, task.BALL_TO_PALM], axis=1) < task.REACH)
    lifted, there = begins(episode), first(task.success(seen))
    if near is None or lifted is None or there is None or not 0 < near < lifted < there:
        return np.zeros(episode.length), np.zeros(episode.length)
    ball = np.interp(steps, [0, near, lifted, there], [0.0, 1.0, 1.0, 0.0])
    return ball, np.interp(steps, [lifted, there], [0.0, 1.0])


def begins(episode: Episode) -> int | None:
    """Step in which the ball is lifted; None if it never is."""
    return first(lifted(episode.observations[1:], episode.start[TARGET_POSITION]))


def lifted(observations: NDArray[np.float32], target: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the ball is off the table, bool [...], of observations [..., 39].

    Args:
        observations: which show where the ball is from its target.
        target: where that is, [..., 3] or [3], m.
    """
    return observations[..., task.TARGET_TO_BALL][..., 2] + target[..., 2] > task.LIFTED


VARYING: Final = Varying(
    name="RelocateVariation",
    task=RELOCATE,
    schema=SCHEMA,
    apart=lambda source, new: float(np.linalg.norm(np.concatenate(offsets(source, new)))),
    apart_key="ball_and_target_offset_m",
    scale_key="offset_scale_m",
    progress="minus the ball's distance from its target in m",
    guided=Guided(GUIDE, offsets, follow),
    begins=begins,
    # Also of a ball that came to its target and fell: nobody is to learn to let go of it.
    under_way=lambda observations, placement: lifted(observations, placement[TARGET_POSITION]),
    patience=30,
)
VARY: Final = HandVariation(VARYING, scale=0.05)
