"""What tasks of the hand judge arrays with. NumPy only, no simulator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def never(observation: NDArray[np.floating]) -> NDArray[np.bool_]:
    """No observation ends an episode: False, shape ``[...]``. Its time limit truncates it."""
    return np.zeros(np.shape(observation)[:-1], dtype=bool)


def norm(vector: NDArray[np.floating]) -> NDArray[np.float64]:
    """Euclidean lengths of vectors ``[..., k]``, shape ``[...]``."""
    return np.linalg.norm(vector, axis=-1)
