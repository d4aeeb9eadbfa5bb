"""Curves of runs that were measured at other times than one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def on_grid(x: Sequence[float], y: Sequence[float], grid: ArrayLike) -> NDArray[np.float64]:
    """The curve ``y(x)`` read at ``grid`` [T]: the last value measured by then.

    Before the first measurement it is the first one, since every run is measured at its start.

    Args:
        x: Increasing, shape [N].
        y: Shape [N].
        grid: Shape [T].
    """
    index = np.searchsorted(np.asarray(x, dtype=np.float64), np.asarray(grid), side="right") - 1
    return np.asarray(y, dtype=np.float64)[np.clip(index, 0, None)]
