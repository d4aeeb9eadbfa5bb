"""Which episodes of a set are imitated, and up to where."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from envs.demonstrations.episode import Episode
from envs.door import task


def require_share(share: float) -> None:
    """Raise ``ValueError`` unless ``share`` is in (0, 1]."""
    if not 0.0 < share <= 1.0:
        raise ValueError(f"demos.keep_best is a share of the episodes, in (0, 1], got {share}")


def highest_returns(episodes: Sequence[Episode], share: float) -> list[Episode]:
    """Keep the episodes of highest return, in the order in which they came.

    Cloning only these is percentile behaviour cloning (Chen et al., 2021, arXiv:2106.01345,
    section 5.1). A door's return grows with the time for which it stands open, so the quick
    episodes that hold the door are kept.

    Args:
        episodes: with their rewards.
        share: of the episodes to keep, in (0, 1], rounded up to a whole episode. Of equal returns
            the earlier one is kept.

    Raises:
        ValueError: ``share`` is out of its range.
    """
    require_share(share)
    returns = np.array([episode.rewards.sum() for episode in episodes])
    best = np.argsort(-returns, kind="stable")[: math.ceil(share * len(episodes))]
    return [episodes[i] for i in sorted(best)]


def require_end_angle(angle: float) -> None:
    """Raise ``ValueError`` unless ``angle`` (rad) is in (0, the fully open door)."""
    if not 0.0 < angle < task.FULLY_OPEN:
        raise ValueError(
            f"demos.end_angle is a hinge angle in rad, above 0 and below {task.FULLY_OPEN} "
            f"(null keeps whole episodes), got {angle}"
        )


def ended_at(episodes: Sequence[Episode], angle: float) -> list[Episode]:
    """End every episode at the first transition after which the hinge is beyond ``angle``.

    What a hand does behind an open door is not part of opening it. A policy without memory that
    imitates it also moves away from a door that it only believes to be open, and then hardly ever
    comes back (docs/results/ablations.md, section 14).

    Deviation: the paper imitates whole demonstrations (section IV-B). Off unless an angle is given.

    Args:
        episodes: to end. One that never gets beyond the angle is kept as it is.
        angle: hinge angle in rad, in (0, `envs.door.task.FULLY_OPEN`).

    Returns:
        The episodes, in their order. The end is a cut, not a terminal state: ``terminated`` stays
        what it was, so that a value is bootstrapped from the last observation.

    Raises:
        ValueError: ``angle`` is out of its range.
    """
    require_end_angle(angle)
    return [_first_steps(episode, _steps_to(episode, angle)) for episode in episodes]


def _steps_to(episode: Episode, angle: float) -> int:
    beyond = np.flatnonzero(task.hinge_angle(episode.observations[1:]) > angle)
    return int(beyond[0]) + 1 if beyond.size else episode.length


def _first_steps(episode: Episode, steps: int) -> Episode:
    return dataclasses.replace(
        episode,
        observations=episode.observations[: steps + 1],
        actions=episode.actions[:steps],
        rewards=episode.rewards[:steps],
        terminated=episode.terminated[:steps],
    )
