"""Learning curves of published cells, as SVG that is made when the site is built."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import trim_mean

from docs.site import cells
from docs.site.page import Page
from docs.site.places import ROOT
from docs.site.task_tables import ONCE, complete
from pipeline.results.cells import OWN, Place
from pipeline.results.curves import column, on_grid
from pipeline.results.run_tables import RETURN
from pipeline.results.runs import RunGroup

FIGURES: Final = ROOT / "build" / "figures"
SCORES: Final = {ONCE.key: "success once", RETURN: "return"}
"""What is drawn: the first that a row's curves tell."""
COLUMNS: Final = 3
PANEL_INCHES: Final = (3.6, 2.8)
REPRODUCIBLE: Final[Any] = {"svg.hashsalt": "bc-sac", "svg.fonttype": "none"}
Drawn = Callable[[Axes], None]


def of_method(page: Page) -> str:
    """The curves of a page's variants, a panel for each task and reward."""
    places = [
        place
        for place in cells.published()
        if (row := cells.result(*place)) and cells.variant(row) in page.about["variants"]
    ]
    name = page.path.stem
    return _panels(places, page, name) or "No learning curve of this method is published yet."


def of_tasks(page: Page) -> str:
    """The curves of all rows of the listed cells, a panel for each task and reward."""
    places = list(cells.listed())
    return _panels(places, page, "tasks") or "No learning curve of a cell is published yet."


def profiles(page: Page) -> str:
    """Share of runs beyond each score, over all of our tasks; nothing while cells are missing."""
    rewards = dict.fromkeys(place[1] for place in cells.published())
    found = {reward: scores for reward in rewards if (scores := complete(reward))}
    if not found:
        return "A performance profile needs a row with a cell at each of our tasks: none has yet."
    panels = {f"{reward}: runs above a score": _profile(scores) for reward, scores in found.items()}
    return _figure(panels, page, "profiles", "share of runs above each share of success, by row")


def _panels(places: Sequence[Place], page: Page, name: str) -> str:
    rows: dict[tuple[str, str], list[RunGroup]] = {}
    for task, reward, row in places:
        found = cells.result(task, reward, row)
        if found is not None and _score(found) is not None:
            rows.setdefault((task, reward), []).append(found)
    panels = {
        task if reward == OWN else f"{task}, {reward}": _curves(of_one)
        for (task, reward), of_one in rows.items()
    }
    told = "; ".join(panels)
    return _figure(panels, page, f"{name}_curves", f"learning curves: {told}") if panels else ""


def _figure(panels: Mapping[str, Drawn], page: Page, name: str, says: str) -> str:
    columns = min(COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    size = (PANEL_INCHES[0] * columns, PANEL_INCHES[1] * lines)
    with mpl.rc_context(REPRODUCIBLE):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(lines, columns, squeeze=False).flat
        for axis, (title, draw) in zip(axes, panels.items(), strict=False):
            draw(axis)
            axis.set_title(title, fontsize="medium")
            axis.grid(alpha=0.3)
            axis.spines[["top", "right"]].set_visible(False)
            axis.legend(fontsize="x-small", frameon=False)
        for axis in list(axes)[len(panels) :]:
            axis.remove()
        path = FIGURES / f"{name}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
    return f"![{says}]({os.path.relpath(path, page.path.parent)})"


def _curves(rows: Sequence[RunGroup]) -> Drawn:
    def draw(axis: Axes) -> None:
        keys = {_score(row) for row in rows} - {None}
        key = next(key for key in SCORES if key in keys)
        for number, row in enumerate(rows):
            if _score(row) == key:
                _curve(axis, row, key, f"C{number}")
        offline = all(run.evaluation.made_from.frames == 0 for r in rows for run in r.runs)
        axis.set(xlabel="updates" if offline else "environment frames", ylabel=SCORES[key])
        axis.xaxis.set_major_formatter(lambda frames, _: f"{frames / 1000:g}k")

    return draw


def _curve(axis: Axes, row: RunGroup, key: str, colour: str) -> None:
    """A thin line for each seed, and their interquartile mean."""
    runs = [column(run, key) for run in row.runs]
    grid = np.unique(runs[0][0][runs[0][0] <= min(frames[-1] for frames, _ in runs)])
    values = np.stack([on_grid(frames, scores, grid) for frames, scores in runs])
    if len(runs) > 1:
        axis.plot(grid, values.T, color=colour, alpha=0.25, linewidth=0.8)
    label = f"{row.name}, {len(runs)} seed{'s' if len(runs) > 1 else ''}"
    axis.plot(grid, trim_mean(values, cells.QUARTER, axis=0), color=colour, label=label)


def _profile(scores: Mapping[str, np.ndarray]) -> Drawn:
    def draw(axis: Axes) -> None:
        levels = np.linspace(0.0, 1.0, 51)
        for name, of_row in scores.items():
            above = (of_row.reshape(-1, 1) > levels).mean(axis=0)
            axis.step(levels, above, where="post", label=name)
        axis.set(xlabel=SCORES[ONCE.key], ylabel="share of tasks and seeds")

    return draw


def _score(row: RunGroup) -> str | None:
    """What can be drawn of every seed of a row; None if nothing can."""
    told = (key for key in SCORES if all(len(column(run, key)[0]) > 1 for run in row.runs))
    return next(told, None)
