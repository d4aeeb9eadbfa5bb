"""Learning curves of a group of runs, which were measured at other times than one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pipeline.files.curves import FRAMES, WALL_S, is_number
from pipeline.results.runs import EvaluatedRun, RunGroup
from pipeline.results.statistics import Floats, over_seeds


@dataclass(frozen=True)
class Axis:
    """What a learning curve is drawn over.

    Attributes:
        key: column of the learning curve.
        label: with the unit.
        scale: turns the column's unit into the label's.
        points: of an even grid for runs that are measured at other places than one another; None
            takes the places of a row's first run.
    """

    key: str
    label: str
    scale: float = 1.0
    points: int | None = None


AXES: Final = (
    Axis(FRAMES, "environment frames"),
    Axis("simulator_steps", "simulator steps"),
    Axis(WALL_S, "wall time (min)", 1 / 60, points=60),
)
"""Frames alone are not what a run costs: demonstrations are simulated too, and time is another."""


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
    # Its keys are those of curves there are, whatever loss.imitation is.
    Panel("imitation error (nats; mse: squared action)", ("bc_nll_train", "bc_nll_held_out")),
)
"""What explains a success or a failure."""


@dataclass(frozen=True)
class Band:
    """A curve of a group: shapes [T].

    ``mean`` is the interquartile mean over runs, ``low`` and ``high`` bound its 95 % interval; of
    one or two runs there is none, and they equal the mean (``statistics.over_seeds``).
    """

    x: Floats
    mean: Floats
    low: Floats
    high: Floats


def curve_of(
    group: RunGroup,
    key: str,
    x: str = FRAMES,
    *,
    points: int | None = None,
) -> Band | None:
    """A column of the learning curves of a group, as far as the shortest of them.

    None if no run has it; a run whose curve lacks it is left out. A run that was measured at other
    places is read at those of the grid: the last value measured by then.

    Args:
        group: Its runs.
        key: Of the column.
        x: Of the column over which it is.
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
    found = over_seeds(values)
    return Band(grid, found.iqm, found.low, found.high)


def curves_over(rows: Sequence[RunGroup], key: str, axis: Axis) -> dict[int, Band]:
    """Curves of several rows over one axis, by the place of the row among them.

    A row is left out if one of its runs has the column but not the axis, as of before simulator
    steps were counted: what nobody counted is not 0. A row that took no frames counts updates, so
    over frames and simulator steps it is a level: what it reached in the end, from where it had
    taken all its steps to the end of the longest other curve.

    Args:
        rows: In their order.
        key: Of the column.
        axis: See ``AXES``.
    """
    found = {
        place: band
        for place, row in enumerate(rows)
        if all(len(column(run, key, axis.key)[0]) for run in row.runs if len(column(run, key)[0]))
        if (band := curve_of(row, key, axis.key, points=axis.points if len(row.runs) > 1 else None))
    }
    if axis.key != WALL_S:
        learning = [band.x[-1] for place, band in found.items() if not is_offline(rows[place])]
        if learning:
            end = float(max(learning))
            found = {
                place: _level(band, 0.0 if axis.key == FRAMES else float(band.x[-1]), end)
                if is_offline(rows[place])
                else band
                for place, band in found.items()
            }
    return {place: replace(band, x=axis.scale * band.x) for place, band in found.items()}


def tells(row: RunGroup, axis: Axis) -> bool:
    """Whether every learning curve of a row tells an axis; False without any."""
    known = [run for run in row.runs if run.curve]
    return bool(known) and all(len(column(run, axis.key)[0]) for run in known)


def is_offline(row: RunGroup) -> bool:
    """Whether it took no frames, so that its learning curve is over updates."""
    return bool(row.told("frames") == 0)


def _level(band: Band, begin: float, end: float) -> Band:
    """The last value of a curve."""
    x = np.unique([begin, max(begin, end)])
    return Band(x, *(np.repeat(v[-1], len(x)) for v in (band.mean, band.low, band.high)))


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
