"""A figure of a row with its interval, the same in every table and report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

from envs.reference import Column
from pipeline.results.run_tables import over_episodes, with_interval
from pipeline.results.runs import RunGroup
from pipeline.results.statistics import SEVERAL, over_seeds

HOW: Final = (
    "Brackets are 95 % intervals. From three seeds on: the interquartile mean over seeds and its "
    "stratified bootstrap (rliable). Two seeds: their mean alone. One seed: over its episodes "
    "(Wilson's interval of a share, the normal one of the return), which says nothing about other "
    "seeds."
)


@dataclass(frozen=True)
class Estimated:
    """Of a row, in the figure's own unit; ``interval`` is None where none can be told."""

    value: float
    interval: tuple[float, float] | None

    def text(self, column: Column) -> str:
        """As tables show it."""
        return with_interval(column, self.value, self.interval)


def estimate(row: RunGroup, column: Column) -> Estimated | None:
    """A figure of the evaluations of a row, see ``HOW``.

    None if one of them lacks it, if it is no number there, or if there are none.
    """
    try:
        values = row.figures(column.key)
    except ValueError:  # of a task's own: that keeps no other figure out
        return None
    if not values:
        return None
    if len(values) == 1:
        return Estimated(values[0], over_episodes(row.evaluations[0], column))
    value, low, high = _of_seeds(tuple(values))
    return Estimated(value, (low, high) if len(values) >= SEVERAL else None)


@cache
def _of_seeds(values: tuple[float, ...]) -> tuple[float, float, float]:
    found = over_seeds([[value] for value in values])
    return float(found.iqm[0]), float(found.low[0]), float(found.high[0])
