"""A number with its interval: over seeds, or over the episodes of the only one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import bootstrap

from envs.reference import Column
from pipeline.report.rows import ReportRow
from pipeline.results.curves import on_grid
from pipeline.results.run_tables import over_episodes, with_interval

Floats = NDArray[np.float64]
REPETITIONS = 2000
"""Bootstrap samples."""
SEED = 0
"""Of the bootstrap: the same runs give the same interval."""
HOW = (
    "Brackets are 95 % intervals. With several seeds: the mean over seeds and the percentile "
    "bootstrap over them. With one seed: over its episodes (Wilson's interval of a share, the "
    "normal one of the return), which says nothing about other seeds."
)


def estimate(row: ReportRow, column: Column) -> str | None:
    """A figure of the evaluations of a row; None if one of them lacks it or there are none."""
    try:
        values = row.figures(column.key)
    except ValueError:  # of a task's own, and no number: that keeps no other figure out
        return None
    if not values:
        return None
    if len(values) == 1:
        (evaluation,) = (run.evaluation for run in row.runs if run.evaluation is not None)
        return with_interval(column, values[0], over_episodes(evaluation, column))
    (mean,), (low,), (high,) = mean_over_runs([[value] for value in values])
    return with_interval(column, float(mean), (float(low), float(high)))


def mean_over_runs(values: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Mean over runs and its 95 % interval, a percentile bootstrap of them; each [T].

    Args:
        values: [S, T] of S > 1 runs.
    """
    array = np.asarray(values, dtype=np.float64)
    found = bootstrap(
        (array,),
        np.mean,
        n_resamples=REPETITIONS,
        vectorized=True,
        method="percentile",
        random_state=np.random.default_rng(SEED),
    ).confidence_interval
    return array.mean(axis=0), found.low, found.high


@dataclass(frozen=True)
class Band:
    """A curve of a row: shapes [T]; ``low`` and ``high`` equal ``mean`` for one seed."""

    x: Floats
    mean: Floats
    low: Floats
    high: Floats


def curve_of(row: ReportRow, key: str, x: str = "frames") -> Band | None:
    """A column of the learning curves of a row, as far as the shortest of them.

    None if no run has it. A run whose curve lacks it, or begins with other numbers of frames, is
    read at the first one's: the last value measured by then.
    """
    curves = []
    for run in row.runs:
        known = [(r[x], r[key]) for r in run.curve if _is_number(r.get(key)) and x in r]
        if known:
            curves.append(tuple(zip(*known, strict=True)))
    if not curves:
        return None
    end = min(places[-1] for places, _ in curves)
    grid = np.unique([place for place in curves[0][0] if place <= end]).astype(np.float64)
    if not grid.size:
        return None
    values = [on_grid(places, measured, grid) for places, measured in curves]
    if len(values) == 1:
        return Band(grid, values[0], values[0], values[0])
    return Band(grid, *mean_over_runs(values))


def last_of(row: ReportRow, key: str) -> float | None:
    """Mean over the runs of a row of the last value of a column of their learning curves."""
    found = []
    for run in row.runs:
        known = [r[key] for r in run.curve if _is_number(r.get(key))]
        found += known[-1:]
    return float(np.mean(found)) if found else None


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)
