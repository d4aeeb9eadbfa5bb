"""Learning curves of a group of runs, which were measured at other times than one another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import bootstrap

from pipeline.files.curves import FRAMES, is_number
from pipeline.results.runs import EvaluatedRun, RunGroup

Floats = NDArray[np.float64]
REPETITIONS: Final = 2000
"""Bootstrap samples."""
SEED: Final = 0
"""Of the bootstrap: the same runs give the same interval."""


@dataclass(frozen=True)
class Panel:
    """What is drawn together.

    Attributes:
        title: with the unit.
        keys: columns of the learning curve.
        logarithmic: whether the axis is.
    """

    title: str
    keys: tuple[str, ...]
    logarithmic: bool = False


DIAGNOSTICS: Final = (
    Panel("gradient on the actor", ("grad_norm_rl", "grad_norm_bc"), logarithmic=True),
    Panel("cosine of the two gradients", ("grad_cosine",)),
    Panel("values in demonstrated states", ("q_demo_actions", "q_policy_actions")),
    Panel("entropy (nats)", ("entropy", "target_entropy")),
    Panel("imitation error (nats)", ("bc_nll_train", "bc_nll_held_out")),
)
"""What explains a success or a failure."""


@dataclass(frozen=True)
class Band:
    """A curve of a group: shapes [T]; ``low`` and ``high`` equal ``mean`` for one run."""

    x: Floats
    mean: Floats
    low: Floats
    high: Floats


Statistic = Callable[[Floats], tuple[Floats, Floats, Floats]]
"""Of values [S, T] of S > 1 runs: a mean and the bounds of its 95 % interval, each [T]."""


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


def curve_of(
    group: RunGroup,
    key: str,
    x: str = FRAMES,
    *,
    statistic: Statistic = mean_over_runs,
    points: int | None = None,
) -> Band | None:
    """A column of the learning curves of a group, as far as the shortest of them.

    None if no run has it; a run whose curve lacks it is left out. A run that was measured at other
    places is read at those of the grid: the last value measured by then.

    Args:
        group: Its runs.
        key: Of the column.
        x: Of the column over which it is.
        statistic: Over the runs.
        points: Of an even grid that begins at 0; None takes the places of the first run.
    """
    measured = [(places, values) for run in group.runs for places, values in [column(run, key, x)]]
    curves = [(places, values) for places, values in measured if len(places)]
    if not curves:
        return None
    end = min(places[-1] for places, _ in curves)
    first = curves[0][0]
    grid = np.unique(first[first <= end]) if points is None else np.linspace(0.0, end, points)
    if not grid.size:
        return None
    values = np.stack([on_grid(places, values, grid) for places, values in curves])
    if len(values) == 1:
        return Band(grid, values[0], values[0], values[0])
    return Band(grid, *statistic(values))


def column(run: EvaluatedRun, key: str, x: str = FRAMES) -> tuple[Floats, Floats]:
    """Where a column of a run's curve was measured, and what, each [N]; N is 0 without any."""
    known = [
        (row[x], row[key]) for row in run.curve if is_number(row.get(key)) and is_number(row.get(x))
    ]
    places, values = zip(*known, strict=True) if known else ((), ())
    return np.asarray(places, dtype=np.float64), np.asarray(values, dtype=np.float64)


def last_of(group: RunGroup, key: str) -> float | None:
    """Mean over the runs of a group of the last value of a column of their learning curves."""
    found = [values[-1] for run in group.runs if len(values := column(run, key)[1])]
    return float(np.mean(found)) if found else None


def on_grid(x: Sequence[float] | Floats, y: Sequence[float] | Floats, grid: ArrayLike) -> Floats:
    """The curve ``y(x)`` read at ``grid`` [T]: the last value measured by then.

    Before the first measurement it is the first one, since every run is measured at its start.

    Args:
        x: Increasing, shape [N].
        y: Shape [N].
        grid: Shape [T].
    """
    index = np.searchsorted(np.asarray(x, dtype=np.float64), np.asarray(grid), side="right") - 1
    return np.asarray(y, dtype=np.float64)[np.clip(index, 0, None)]
