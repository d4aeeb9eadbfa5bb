"""Which episodes of a set are imitated, and up to where."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError


def require_share(share: float) -> None:
    """Raise ``ValueError`` unless ``share`` is in (0, 1]."""
    if not 0.0 < share <= 1.0:
        raise ValueError(f"demos.keep_best is a share of the episodes, in (0, 1], got {share}")


def highest_returns(episodes: Sequence[Episode], share: float) -> list[Episode]:
    """Keep the episodes of highest return, in the order in which they came.

    Cloning only these is percentile behaviour cloning (Chen et al., 2021, arXiv:2106.01345,
    section 5.1). Where a return grows with the time of success, the quick episodes are kept.

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


def require_end_progress(progress: float, full: float | None) -> None:
    """Raise ``ValueError`` unless ``progress`` is above 0 and below ``full``."""
    if not 0.0 < progress < (math.inf if full is None else full):
        raise ValueError(
            f"demos.end_progress must be above 0{'' if full is None else f' and below {full}'} "
            f"(null keeps whole episodes), got {progress}"
        )


def ended_at(episodes: Sequence[Episode], progress: float) -> list[Episode]:
    """End every episode at the first transition that gets beyond ``progress``.

    What is shown behind the goal is not part of getting there. A policy without memory that
    imitates it also does it where it only believes to be there, and then hardly ever comes back
    (docs/lab/notes/20-demonstration-end.md).

    Deviation: the paper imitates whole demonstrations (section IV-B). Off unless a bound is given.

    Args:
        episodes: to end. One that never gets beyond the bound is kept as it is.
        progress: in the task's unit, > 0.

    Returns:
        The episodes, in their order. The end is a cut, not a terminal state: ``terminated`` stays
        what it was, so that a value is bootstrapped from the last observation.

    Raises:
        ValueError: ``progress`` is not positive.
        DemonstrationError: an episode has no progress.
    """
    require_end_progress(progress, None)
    return [episode.first_steps(_steps_to(episode, progress)) for episode in episodes]


def _steps_to(episode: Episode, progress: float) -> int:
    if episode.progress is None:
        raise DemonstrationError(
            episode.provenance,
            f"has no progress, which demos.end_progress={progress} bounds",
            "Set demos.end_progress=null, or use a task whose demonstrations tell their progress",
        )
    beyond = np.flatnonzero(episode.progress[1:] > progress)
    return int(beyond[0]) + 1 if beyond.size else episode.length
