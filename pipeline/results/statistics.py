"""Interquartile means over seeds with stratified bootstrap intervals (rliable).

Every interval over seeds that a table, a figure or a report shows is from here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rliable import library, metrics
from scipy.stats import trim_mean

SEVERAL: Final = 3
"""Seeds from which on an interval is of the seeds: of two, a bootstrap knows three means."""
REPETITIONS = 2000
"""Bootstrap samples."""
AT_ONCE = 64
"""Points of a curve whose bootstrap samples are held together."""
SEED = 0
"""Of the bootstrap: the same runs give the same interval."""

PERCENT_95: Final = (2.5, 97.5)

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
    found = {}
    for name, values in curves.items():
        array = np.asarray(values, dtype=np.float64)
        if array.ndim != 2 or array.size == 0 or not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite values [seeds, points], got {array.shape}")
        draws = _draws(len(array))
        low, high = np.concatenate(
            [
                np.percentile(_iqm(array[draws, points]), PERCENT_95, axis=0)
                for points in np.array_split(
                    np.arange(array.shape[1])[None, None, :], -(-array.shape[1] // AT_ONCE), axis=2
                )
            ],
            axis=1,
        )
        found[name] = Estimate(_iqm(array[None])[0], low, high)
    return found


def over_seeds(values: ArrayLike) -> Estimate:
    """What tables and figures show of several seeds.

    From ``SEVERAL`` seeds on, interquartile means with intervals; of fewer their mean, whose bounds
    equal it: there is no interval.

    Args:
        values: [S, T] of S seeds at T points.

    Raises:
        ValueError: If values are not [S, T] or not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if len(array) >= SEVERAL:
        return interquartile_means({"row": array})["row"]
    mean = array.mean(axis=0)
    return Estimate(mean, mean, mean)


def _iqm(runs: Floats) -> Floats:
    """As ``aggregate_iqm`` of rliable of one task, of many samples at once: [R, S, T] to [R, T]."""
    trimmed: Floats = trim_mean(runs, 0.25, axis=1)
    return trimmed


@cache
def _draws(seeds: int) -> NDArray[np.intp]:
    """The runs that rliable draws of so many, [R, S, 1].

    It calls a function for each of its samples, half a second for a figure; a report has hundreds,
    all of the same draws.
    """
    numbers = np.arange(seeds)[:, None]  # one task
    with _drawn_alike():
        samples = library.StratifiedBootstrap(numbers).bootstrap(REPETITIONS)
        return np.stack([args[0] for args, _ in samples])


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
