"""A number with its interval: over seeds, or over the episodes of the only one."""

from __future__ import annotations

from envs.reference import Column
from pipeline.results.curves import mean_over_runs
from pipeline.results.run_tables import over_episodes, with_interval
from pipeline.results.runs import RunGroup

HOW = (
    "Brackets are 95 % intervals. With several seeds: the mean over seeds and the percentile "
    "bootstrap over them. With one seed: over its episodes (Wilson's interval of a share, the "
    "normal one of the return), which says nothing about other seeds."
)


def estimate(row: RunGroup, column: Column) -> str | None:
    """A figure of the evaluations of a row; None if one of them lacks it or there are none."""
    try:
        values = row.figures(column.key)
    except ValueError:  # of a task's own, and no number: that keeps no other figure out
        return None
    if not values:
        return None
    if len(values) == 1:
        return with_interval(column, values[0], over_episodes(row.evaluations[0], column))
    (mean,), (low,), (high,) = mean_over_runs([[value] for value in values])
    return with_interval(column, float(mean), (float(low), float(high)))
