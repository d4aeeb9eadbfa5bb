"""Actions in units of their own and in [-1, 1]: one pair of formulas, for environments and files.

Bounds are numbers or arrays that fit the last dimension, ``low`` below ``high``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def to_unit(actions: ArrayLike, low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
    """Actions [..., A] between ``low`` and ``high`` in [-1, 1]; what is beyond stays beyond."""
    least, most = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return 2.0 * (np.asarray(actions, np.float64) - least) / (most - least) - 1.0


def from_unit(unit: ArrayLike, low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
    """Actions [..., A] of [-1, 1] between ``low`` and ``high``; what is beyond stays beyond."""
    share = (np.asarray(unit, np.float64) + 1.0) / 2.0
    # In this form -1 and 1 are the bounds exactly.
    return np.asarray(low, np.float64) * (1.0 - share) + np.asarray(high, np.float64) * share
