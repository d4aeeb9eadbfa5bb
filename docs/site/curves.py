"""Learning curves of published cells, as SVG that is made when the site is built."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.site import cells
from docs.site.page import Page
from docs.site.places import ROOT
from docs.site.task_tables import ONCE, complete
from pipeline.files.curves import FRAMES, WALL_S
from pipeline.results.cells import OWN, Place
from pipeline.results.curves import AXES, Axis, column, curves_over, is_offline
from pipeline.results.plots import plot_curves
from pipeline.results.rows import load_published
from pipeline.results.run_tables import RETURN
from pipeline.results.runs import RunGroup

FIGURES: Final = ROOT / "build" / "figures"
SCORES: Final = {ONCE.key: "success once", RETURN: "return"}
"""What is drawn: the first that a row's curves tell."""
LONGEST: Final = 40
"""Characters of a title that a panel has room for."""
PANEL_INCHES: Final = (3.6, 2.8)
REPRODUCIBLE: Final[Any] = {"svg.hashsalt": "bc-sac", "svg.fonttype": "none"}
Drawn = Callable[[Axes], None]


def of_method(page: Page) -> str:
    """The curves of a page's variants: for each task and reward a line, a panel for each axis."""
    places = [
        place
        for place in cells.published()
        if (row := cells.result(*place)) and cells.variant(row) in page.about["variants"]
    ]
    name = page.path.stem
    return _panels(places, page, name) or "No learning curve of this method is published yet."


def of_tasks(page: Page) -> str:
    """The curves of all rows of the listed cells, likewise."""
    places = list(cells.listed())
    return _panels(places, page, "tasks") or "No learning curve of a cell is published yet."


def of_results(page: Page) -> str:
    """Success and return of the published rows of the paper's task, a figure for each axis."""
    rows = load_published(page.path.parent)
    drawn = []
    for axis in AXES:
        path = FIGURES / f"results_{axis.key}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        plot_curves(rows, axis, path)
        says = f"success and return over {axis.label}, mean and interval over seeds"
        drawn.append(f"![{says}]({os.path.relpath(path, page.path.parent)})")
    return "\n\n".join(drawn)


def profiles(page: Page) -> str:
    """Share of runs beyond each score, over all of our tasks; nothing while cells are missing."""
    rewards = dict.fromkeys(place[1] for place in cells.published())
    found = {reward: scores for reward in rewards if (scores := complete(reward))}
    if not found:
        return "A performance profile needs a row with a cell at each of our tasks: none has yet."
    panels = [(f"{reward}: runs above a score", _profile(s)) for reward, s in found.items()]
    return _figure(panels, page, "profiles", "share of runs above each share of success, by row")


def _panels(places: Sequence[Place], page: Page, name: str) -> str:
    rows: dict[tuple[str, str], list[RunGroup]] = {}
    for task, reward, row in places:
        found = cells.result(task, reward, row)
        if found is not None and _score(found) is not None:
            rows.setdefault((task, reward), []).append(found)
    titled = {
        task if reward == OWN else f"{task}, {reward}": of_one
        for (task, reward), of_one in rows.items()
    }
    panels = [(title, _curves(of_one, axis)) for title, of_one in titled.items() for axis in AXES]
    says = f"learning curves over {', '.join(axis.label for axis in AXES)}: {'; '.join(titled)}"
    return _figure(panels, page, f"{name}_curves", says) if panels else ""


def _figure(panels: Sequence[tuple[str, Drawn]], page: Page, name: str, says: str) -> str:
    columns = min(len(AXES), len(panels))
    lines = -(-len(panels) // columns)
    size = (PANEL_INCHES[0] * columns, PANEL_INCHES[1] * lines)
    with mpl.rc_context(REPRODUCIBLE):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(lines, columns, squeeze=False).flat
        for axis, (title, draw) in zip(axes, panels, strict=False):
            draw(axis)
            # Of a long name of somebody's environment, a part a line.
            lines_of = title.replace(":", ":\n") if len(title) > LONGEST else title
            axis.set_title(lines_of, fontsize="medium")
            axis.grid(alpha=0.3)
            axis.spines[["top", "right"]].set_visible(False)
            if axis.lines:
                axis.legend(fontsize="x-small", frameon=False)
        for axis in list(axes)[len(panels) :]:
            axis.remove()
        path = FIGURES / f"{name}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
    return f"![{says}]({os.path.relpath(path, page.path.parent)})"


def _curves(rows: Sequence[RunGroup], x: Axis) -> Drawn:
    """A thin line for each seed, and their interquartile mean; rows that do not tell are named."""

    def draw(axis: Axes) -> None:
        keys = {_score(row) for row in rows} - {None}
        key = next(key for key in SCORES if key in keys)
        told = curves_over(rows, key, x)
        for place, band in told.items():
            row, colour = rows[place], f"C{place}"
            if len(row.runs) > 1 and not (is_offline(row) and x.key != WALL_S):
                for run in row.runs:
                    places, values = column(run, key, x.key)
                    axis.plot(x.scale * places, values, color=colour, alpha=0.25, linewidth=0.8)
            label = f"{row.name}, {len(row.runs)} seed{'s' if len(row.runs) > 1 else ''}"
            marker = "" if len(band.x) > 1 else "o"
            axis.plot(band.x, band.mean, color=colour, label=label, marker=marker)
        lacking = [row.name for n, row in enumerate(rows) if n not in told and _score(row) == key]
        if lacking:
            axis.text(
                0.98, 0.02, "\n".join(["not counted:", *lacking]), fontsize="xx-small",
                transform=axis.transAxes, ha="right", va="bottom",
            )  # fmt: skip
        offline = all(is_offline(row) for row in rows)
        label = "updates" if offline and x.key == FRAMES else x.label
        axis.set(xlabel=label, ylabel=SCORES[key])
        if x.key != WALL_S:
            axis.xaxis.set_major_formatter(lambda count, _: f"{count / 1000:g}k")

    return draw


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
