"""Interquartile means over seeds with stratified bootstrap intervals (rliable)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rliable import library, metrics
from scipy.stats import trim_mean

REPETITIONS = 2000
"""Bootstrap samples."""
SEED = 0
"""Of the bootstrap: the same runs give the same interval."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """An interquartile mean (arXiv:2108.13264) and its 95 % interval; shapes [T] of a curve."""

    iqm: Floats
    low: Floats
    high: Floats


def interquartile_means(curves: Mapping[str, ArrayLike]) -> dict[str, Estimate]:
    """Estimates by name, the runs of each being the units that are drawn again.

    Args:
        curves: Values [S, T] of S seeds at T points; T is 1 for a final score.

    Raises:
        ValueError: If values are not [S, T] or not finite.
    """
    scores = {}
    for name, values in curves.items():
        array = np.asarray(values, dtype=np.float64)
        if array.ndim != 2 or array.size == 0 or not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite values [seeds, points], got {array.shape}")
        scores[name] = array[:, None, :]  # one task

    def aggregate(runs: Floats) -> Floats:
        # rliable's aggregate_iqm of each point, all points at once.
        trimmed: Floats = trim_mean(runs[:, 0], 0.25, axis=0)
        return trimmed

    with _drawn_alike():
        points, intervals = library.get_interval_estimates(scores, aggregate, reps=REPETITIONS)
    return {n: Estimate(points[n], intervals[n][0], intervals[n][1]) for n in scores}


def over_tasks(scores: Mapping[str, ArrayLike]) -> dict[str, Estimate]:
    """Interquartile means over tasks and seeds, the seeds of each task being drawn again.

    Args:
        scores: [S, N] of S seeds on N tasks, comparable between tasks; shares of success, say.

    Raises:
        ValueError: If values are not [S, N] or not finite.
    """
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in scores.items()}
    for name, array in arrays.items():
        if array.ndim != 2 or array.size == 0 or not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite values [seeds, tasks], got {array.shape}")
    with _drawn_alike():
        points, intervals = library.get_interval_estimates(
            arrays, lambda runs: np.array([metrics.aggregate_iqm(runs)]), reps=REPETITIONS
        )
    return {n: Estimate(points[n], intervals[n][0], intervals[n][1]) for n in arrays}


@contextmanager
def _drawn_alike() -> Iterator[None]:
    """The same draws every time: rliable 1.2 takes numpy's generator, whatever it is given."""
    state = np.random.get_state()
    np.random.seed(SEED)
    try:
        yield
    finally:
        np.random.set_state(state)
