"""Figures of the results: learning curves of all rows, diagnostics of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.files.run_files import RunDirectoryError
from pipeline.results.curves import AXES, DIAGNOSTICS, Axis, Panel, column, curves_over, tells
from pipeline.results.pictures import save_figure
from pipeline.results.runs import EvaluatedRun, RunGroup

SCORES: Mapping[str, str] = {
    "success_once": "share of episodes that succeed",
    "return_mean": "return",
}
NOT_TOLD = "not in these learning curves"
SHARES = Panel("share of episodes", ("success_once", "success_at_end", "train_success"))
PANELS = (*((SHARES, axis) for axis in AXES), *((panel, AXES[0]) for panel in DIAGNOSTICS))
"""The shares over everything that a run costs, what explains them over frames."""


def plot_curves(rows: Sequence[RunGroup], x: Axis, path: Path) -> None:
    """Success and return of all rows over one axis, IQM and 95 % interval over seeds.

    Args:
        rows: Those without a curve are left out, those whose curves lack ``x`` are named.
        x: Of ``AXES``.
        path: PNG to write.
    """
    shown = [row for row in rows if all(len(run.curve) > 1 for run in row.runs)]
    figure = Figure(figsize=(13, 5), layout="constrained")
    axes = figure.subplots(1, len(SCORES))
    colours = mpl.colormaps["tab20"].colors  # type: ignore[attr-defined]  # of a listed colormap
    for axis, (key, label) in zip(axes, SCORES.items(), strict=True):
        for place, band in curves_over(shown, key, x).items():
            colour, row = colours[place % len(colours)], shown[place]
            axis.plot(band.x, band.mean, color=colour, label=f"{row.name} ({len(row.runs)})")
            axis.fill_between(band.x, band.low, band.high, color=colour, alpha=0.2, linewidth=0)
        axis.set(xlabel=x.label, ylabel=label)
        axis.grid(alpha=0.3)
    lacking = [row.name for row in shown if not tells(row, x)]
    if lacking:
        figure.suptitle(f"not counted: {', '.join(lacking)}", fontsize="small")
    axes[-1].legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path)


def plot_diagnostics(title: str, runs: Sequence[EvaluatedRun], path: Path) -> None:
    """Success of the runs of one recipe over all of ``AXES``, diagnostics over frames.

    Args:
        title: Of the figure.
        runs: Of the recipe, a line each; those without a curve are left out.
        path: PNG to write.

    Raises:
        RunDirectoryError: If no run has a curve.
    """
    drawn = [run for run in runs if run.curve]
    if not drawn:
        raise RunDirectoryError(f"{title}: no learning curve; train with evaluation.interval > 0")
    figure = Figure(figsize=(17, 7), layout="constrained")
    figure.suptitle(title)
    for axis, (panel, x) in zip(figure.subplots(2, 4).flat, PANELS, strict=True):
        _lines(axis, drawn, panel, x)
    save_figure(figure, path)


def _lines(axis: Axes, runs: Sequence[EvaluatedRun], panel: Panel, x: Axis) -> None:
    """A line per run and key of the panel; where no run tells ``x``, that is said."""
    for number, key in enumerate(panel.keys):
        label: str | None = key
        for run in runs:
            places, values = column(run, key, x.key)
            if len(places):
                style: dict[str, Any] = {"color": f"C{number}", "alpha": 0.8, "linewidth": 1.2}
                # Of a clone all rows are at the same number of steps.
                marker = "" if np.ptp(places) else "."
                axis.plot(x.scale * places, values, label=label, marker=marker, **style)
                label = None
    axis.set(title=panel.title, xlabel=x.label)
    axis.grid(alpha=0.3)
    if axis.lines:
        axis.set_yscale("log" if panel.logarithmic else "linear")
        axis.legend(fontsize="small")
    else:
        axis.text(0.5, 0.5, NOT_TOLD, transform=axis.transAxes, ha="center", va="center")
