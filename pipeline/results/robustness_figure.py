"""The heat map of ``make robust``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.results.pictures import save_figure
from pipeline.results.robustness import Robustness

DARK = 0.45
"""Success below which a cell is dark and its text white."""


def plot_robustness(found: Robustness, path: Path) -> None:
    """A row for each ladder, a column for each setting, coloured by success; PNG to ``path``."""
    cells = np.full((len(found.ladders), found.most), np.nan)
    figure = Figure(
        figsize=(2.5 + 1.15 * found.most, 1.2 + 0.42 * len(cells)), layout="constrained"
    )
    axes = figure.subplots()
    for row, ladder in enumerate(found.ladders):
        for column, measured in enumerate(ladder.settings):
            share = measured.success
            cells[row, column] = np.nan if share is None else share
            told = "refused" if share is None else f"{100 * share:.0f} %"
            colour = "white" if share is not None and share < DARK else "black"
            text = f"{measured.setting}\n{told}"
            axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    shown = axes.imshow(cells, cmap="viridis", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_yticks(range(len(cells)), [ladder.what for ladder in found.ladders], fontsize=8)
    axes.set_xticks([])
    axes.set_title(
        f"{Path(str(found.made_from['run'])).name}: success of {found.episodes} episodes a cell; "
        f"undisturbed {found.undisturbed.text} %",
        fontsize=9,
    )
    figure.colorbar(shown, ax=axes, label="share of episodes that succeed")
    save_figure(figure, path)
