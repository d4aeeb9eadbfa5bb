"""Which episodes of a set are imitated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from envs.demonstrations.episode import Episode


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
