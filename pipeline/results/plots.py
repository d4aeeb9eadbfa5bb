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
from pipeline.results.curves import on_grid
from pipeline.results.pictures import save_figure
from pipeline.results.rows import ResultRow
from pipeline.results.statistics import interquartile_means

POINTS = 60
"""Of a curve over wall time."""
AXES: Mapping[str, str] = {"frames": "environment frames", "wall_s": "wall time (min)"}
SCORES: Mapping[str, str] = {
    "success_once": "share of episodes that succeed",
    "return_mean": "return",
}
PANELS: Sequence[tuple[str, Sequence[str], bool]] = (
    ("share of episodes", ("success_once", "success_at_end", "train_success"), False),
    ("gradient on the actor", ("grad_norm_rl", "grad_norm_bc"), True),
    ("cosine of the two gradients", ("grad_cosine",), False),
    ("values in demonstrated states", ("q_demo_actions", "q_policy_actions"), False),
    ("entropy (nats)", ("entropy", "target_entropy"), False),
    ("imitation error (nats)", ("bc_nll_train", "bc_nll_held_out"), False),
)  # fmt: skip
"""Title, columns of the learning curve, and whether the axis is logarithmic."""


def plot_curves(rows: Sequence[ResultRow], x: str, path: Path) -> None:
    """Success and return of all rows against ``x``, IQM and 95 % interval over seeds.

    Args:
        rows: Those without a curve over ``x`` are left out.
        x: A key of ``AXES``.
        path: PNG to write.
    """
    shown = [row for row in rows if all(len(_column(s.curve, x)) > 1 for s in row.seeds)]
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


def plot_diagnostics(title: str, curves: Sequence[Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Diagnostics of the runs of one recipe against frames, a line per run.

    Args:
        title: Of the figure.
        curves: Rows of ``learning_curve.jsonl`` of each run.
        path: PNG to write.

    Raises:
        RunDirectoryError: If no run has a curve.
    """
    if not any(curves):
        raise RunDirectoryError(f"{title}: no learning curve; train with evaluation.interval > 0")
    figure = Figure(figsize=(13, 7), layout="constrained")
    figure.suptitle(title)
    for axis, (label, keys, logarithmic) in zip(figure.subplots(2, 3).flat, PANELS, strict=True):
        for number, key in enumerate(keys):
            for run, curve in enumerate(curves):
                y = _column(curve, key)
                known = np.isfinite(y)
                axis.plot(
                    _column(curve, "frames")[known],
                    y[known],
                    color=f"C{number}",
                    alpha=0.8,
                    linewidth=1.2,
                    label=key if run == 0 else None,
                )
        axis.set(title=label, xlabel=AXES["frames"])
        if logarithmic:
            axis.set_yscale("log")
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    save_figure(figure, path)


def _curve(axis: Axes, row: ResultRow, x: str, key: str, colour: Any) -> None:
    places = [_column(seed.curve, x) for seed in row.seeds]
    end = min(place[-1] for place in places)
    grid = np.unique(places[0][places[0] <= end]) if x == "frames" else np.linspace(0, end, POINTS)
    values = []
    for place, seed in zip(places, row.seeds, strict=True):
        column = _column(seed.curve, key)
        known = np.isfinite(place) & np.isfinite(column)
        if not known.any():
            return  # the task does not tell it
        values.append(on_grid(place[known].tolist(), column[known].tolist(), grid))
    estimate = interquartile_means({row.name: values})[row.name]
    shown = grid if x == "frames" else grid / 60.0
    axis.plot(shown, estimate.iqm, color=colour, label=f"{row.name} ({len(row.seeds)})")
    axis.fill_between(shown, estimate.low, estimate.high, color=colour, alpha=0.2, linewidth=0)


def _column(curve: Sequence[Mapping[str, Any]], key: str) -> np.ndarray:
    values = [row.get(key) for row in curve]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
