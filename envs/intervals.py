"""Confidence intervals of shares, for every figure that has one."""

from __future__ import annotations

import numpy as np
import scipy  # `stats` takes half a second to load, and scipy does it where it is first used
from numpy.typing import ArrayLike


def wilson(happened: ArrayLike) -> tuple[float, float]:
    """95 % interval of the share of events that happened; bool [E].

    Wilson's score interval (1927), which stays within [0, 1] and has a width at 0 and at 1.
    """
    events = np.asarray(happened, dtype=bool)
    interval = scipy.stats.binomtest(int(events.sum()), events.size).proportion_ci(
        0.95, method="wilson"
    )
    return float(interval.low), float(interval.high)
