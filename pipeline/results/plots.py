"""Figures of the results: learning curves of all rows, diagnostics of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.files.run_files import RunDirectoryError
from pipeline.results.curves import DIAGNOSTICS, Panel, column, curve_of
from pipeline.results.pictures import save_figure
from pipeline.results.runs import EvaluatedRun, RunGroup
from pipeline.results.statistics import Floats, interquartile_means

POINTS = 60
"""Of a curve over wall time."""
AXES: Mapping[str, str] = {"frames": "environment frames", "wall_s": "wall time (min)"}
SCORES: Mapping[str, str] = {
    "success_once": "share of episodes that succeed",
    "return_mean": "return",
}
PANELS = (
    Panel("share of episodes", ("success_once", "success_at_end", "train_success")),
    *DIAGNOSTICS,
)


def plot_curves(rows: Sequence[RunGroup], x: str, path: Path) -> None:
    """Success and return of all rows against ``x``, IQM and 95 % interval over seeds.

    Args:
        rows: Those without a curve over ``x`` are left out.
        x: A key of ``AXES``.
        path: PNG to write.
    """
    shown = [row for row in rows if all(len(run.curve) > 1 for run in row.runs)]
    figure = Figure(figsize=(13, 5), layout="constrained")
    axes = figure.subplots(1, len(SCORES))
    colours = mpl.colormaps["tab20"].colors  # type: ignore[attr-defined]  # of a listed colormap
    for axis, (key, label) in zip(axes, SCORES.items(), strict=True):
        for row, colour in zip(shown, colours, strict=False):
            _curve(axis, row, x, key, colour)
        axis.set(xlabel=AXES[x], ylabel=label)
        axis.grid(alpha=0.3)
    axes[-1].legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path)


def plot_diagnostics(title: str, runs: Sequence[EvaluatedRun], path: Path) -> None:
    """Diagnostics of the runs of one recipe against frames, a line per run.

    Args:
        title: Of the figure.
        runs: Of the recipe; those without a curve are left out.
        path: PNG to write.

    Raises:
        RunDirectoryError: If no run has a curve.
    """
    drawn = [run for run in runs if run.curve]
    if not drawn:
        raise RunDirectoryError(f"{title}: no learning curve; train with evaluation.interval > 0")
    figure = Figure(figsize=(13, 7), layout="constrained")
    figure.suptitle(title)
    for axis, panel in zip(figure.subplots(2, 3).flat, PANELS, strict=True):
        for number, key in enumerate(panel.keys):
            for place, run in enumerate(drawn):
                axis.plot(
                    *column(run, key),
                    color=f"C{number}",
                    alpha=0.8,
                    linewidth=1.2,
                    label=key if place == 0 else None,
                )
        axis.set(title=panel.title, xlabel=AXES["frames"])
        if panel.logarithmic:
            axis.set_yscale("log")
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    save_figure(figure, path)


def _curve(axis: Axes, row: RunGroup, x: str, key: str, colour: Any) -> None:
    if not all(len(column(run, key, x)[0]) for run in row.runs):
        return  # the task does not tell it
    band = curve_of(row, key, x, statistic=_interquartile, points=None if x == "frames" else POINTS)
    assert band is not None
    shown = band.x if x == "frames" else band.x / 60.0
    axis.plot(shown, band.mean, color=colour, label=f"{row.name} ({len(row.runs)})")
    axis.fill_between(shown, band.low, band.high, color=colour, alpha=0.2, linewidth=0)


def _interquartile(values: Floats) -> tuple[Floats, Floats, Floats]:
    found = interquartile_means({"runs": values})["runs"]
    return found.iqm, found.low, found.high
