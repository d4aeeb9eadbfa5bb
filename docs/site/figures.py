"""The picture of the methods, from the published rows: ``python -m docs.site.figures [OUT]``.

It is committed, so that it shows where the repository is hosted; every other figure is made when it
is wanted. It names the data that it was drawn from (:func:`digest`), so that a test sees a picture
of other data.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.site.places import DOCS
from pipeline.results.curves import on_grid
from pipeline.results.rows import load_published
from pipeline.results.runs import RunGroup
from pipeline.results.statistics import over_seeds

PICTURE: Final = DOCS / "assets" / "curves.png"
SHOWN: Final = {"best": "#0072b2", "dbc_sac": "#009e73", "da_sac": "#d55e00", "sac": "#555555"}
"""Rows that differ in kind, in colours that people with colour blindness tell apart."""
SCORES: Final = {"success_once": "doors opened, share of episodes", "return_mean": "return"}
SIZE_INCHES: Final = (9.6, 3.6)
DPI: Final = 110
SOURCE: Final = "Source"
"""Name of the digest in the picture."""
RESULTS: Final = DOCS / "results"


def digest(results: Path = RESULTS) -> str:
    """SHA-256 (hex) of the published rows that the picture shows."""
    rows = {row.name: row for row in load_published(results)}
    shown = [[run.published() for run in rows[name].runs] for name in (*SHOWN, "bc")]
    return hashlib.sha256(json.dumps(shown, sort_keys=True).encode()).hexdigest()


def draw(path: Path = PICTURE, results: Path = RESULTS) -> None:
    """Writes the picture: interquartile mean and 95 % interval over seeds, over frames."""
    rows = {row.name: row for row in load_published(results)}
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    for axis, (key, label) in zip(figure.subplots(1, len(SCORES)), SCORES.items(), strict=True):
        for name, colour in SHOWN.items():
            _curve(axis, rows[name], key, colour)
        clone = float(np.mean(rows["bc"].figures(key)))
        axis.axhline(clone, color="black", linestyle=":", label="bc, at its end")
        axis.set(xlabel="environment frames", title=label)
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(loc="center left", frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI, metadata={SOURCE: digest(results)})


def _curve(axis: Axes, row: RunGroup, key: str, colour: str) -> None:
    frames = [_column(row, seed, "frames") for seed in range(len(row.runs))]
    end = min(column[-1] for column in frames)
    grid = np.unique([frame for frame in frames[0] if frame <= end])
    values = [on_grid(frames[seed], _column(row, seed, key), grid) for seed in range(len(row.runs))]
    estimate = over_seeds(values)
    axis.plot(grid, estimate.iqm, color=colour, label=f"{row.name}, {len(row.runs)} seeds")
    axis.fill_between(grid, estimate.low, estimate.high, color=colour, alpha=0.2, linewidth=0)


def _column(row: RunGroup, seed: int, key: str) -> Sequence[float]:
    points = row.runs[seed].curve
    # Runs of before the metric had the name that it has on every task.
    former = {"success_once": "share_gt_1_35"}.get(key, key)
    return [float(point.get(key, point.get(former))) for point in points]


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
