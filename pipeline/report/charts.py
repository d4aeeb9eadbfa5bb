"""The report's charts, as figures of plotly: what a page colours by its theme is left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.colors import sample_colorscale

from pipeline.report.page import Chart
from pipeline.results.curves import Band

ROWS_A_PANEL = 4
COLOURS = ("#3b8ed0", "#e08a00", "#12a37a", "#cc6aa4")
"""Of the rows of a panel; readable on light and on dark."""
HEIGHT = 300
LINE_PX = 24
DIGITS = 5
"""Significant digits of what is drawn."""

Item = TypeVar("Item")
Floats = NDArray[np.float64]


def panels(items: Sequence[Item], place: Callable[[Item], int]) -> list[list[Item]]:
    """The items in groups that one panel can show.

    Args:
        items: In their order.
        place: Of an item's row in the report, from 0: a row is in the same panel, and of the same
            colour, in every section, whatever other rows lack.
    """
    return [list(group) for _, group in groupby(items, lambda item: place(item) // ROWS_A_PANEL)]


def chart(
    title: str,
    figure: go.Figure,
    *,
    wide: bool = False,
    over: Mapping[str, go.Figure] = MappingProxyType({}),
) -> Chart:
    """Makes a finished figure part of a section; ``over``: the same over its other axes."""
    others = {key: str(other.to_json()) for key, other in over.items()}
    return Chart(title, str(figure.to_json()), wide, others)


def blank(x: str, y: str, *, share: bool = False, height: int = HEIGHT, **layout: Any) -> go.Figure:
    """A figure without traces.

    Args:
        x: Label of the axis.
        y: Likewise.
        share: Whether the other axis is a share of episodes, from 0 to 1.
        height: px.
        **layout: Further settings of plotly's layout.
    """
    figure = go.Figure()
    figure.update_layout(
        height=height,
        margin={"l": 56, "r": 12, "t": 8, "b": 44},
        font={"size": 12},
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0, "x": 0.0},
        xaxis={"title": {"text": x}},
        yaxis={"title": {"text": y}, **({"range": [-0.02, 1.02]} if share else {})},
        template="none",
        hovermode="closest",
        **layout,
    )
    return figure


@dataclass(frozen=True)
class Curve:
    """A row's curve in a panel."""

    name: str
    band: Band
    place: int
    """Of the row in the report, from 0."""
    reference: float | None = None
    """A published number to stand beside it."""


def curves_panel(
    curves: Sequence[Curve],
    x: str,
    y: str,
    *,
    share: bool = False,
    span: tuple[float, float] | None = None,
) -> go.Figure:
    """Mean and band of a few rows, and a dashed line where there is a published number.

    Args:
        curves: At most ``ROWS_A_PANEL``; of none it is said that they do not tell ``x``.
        x: Label.
        y: Label.
        share: Whether ``y`` is a share of episodes.
        span: Of the vertical axis, where several panels have the same.
    """
    figure = blank(x, y, share=share)
    if span is not None:
        figure.update_yaxes(range=list(span))
    if not curves:
        figure.add_annotation(
            text="not in these learning curves", showarrow=False, x=0.5, y=0.5, xref="paper",
            yref="paper",
        )  # fmt: skip
        figure.update_xaxes(showticklabels=False)
    for curve in curves:
        band, colour = curve.band, COLOURS[curve.place % ROWS_A_PANEL]
        if not np.array_equal(band.low, band.high):
            figure.add_scatter(
                x=short([*band.x, *band.x[::-1]]),
                y=short([*band.high, *band.low[::-1]]),
                mode="lines",  # else a few points have markers, of another colour
                fill="toself",
                fillcolor=_transparent(colour),
                line={"width": 0},
                hoverinfo="skip",
                legendgroup=curve.name,
                showlegend=False,
            )
        figure.add_scatter(
            x=short(band.x),
            y=short(band.mean),
            name=curve.name,
            legendgroup=curve.name,
            mode="lines+markers" if len(band.x) < 2 else "lines",
            line={"color": colour, "width": 2},
        )
        if curve.reference is not None:
            figure.add_hline(y=curve.reference, line={"color": colour, "dash": "dash", "width": 1})
    return figure


def bars(
    parts: Mapping[str, Sequence[float]],
    rows: Sequence[str],
    x: str,
    colours: Sequence[str],
    *,
    share: bool = False,
) -> go.Figure:
    """Horizontal bars, a row each, stacked of parts.

    Args:
        parts: Lengths [rows] by name of the part.
        rows: Names.
        x: Label.
        colours: Of the parts.
        share: Whether a bar is whole at 1.
    """
    # The legend of many parts takes lines of its own above the bars.
    legend = LINE_PX * (1 + len(parts) // 3)
    height = 70 + legend + (LINE_PX + 8) * len(rows)
    figure = blank(x, "", height=height, barmode="stack")
    for (name, lengths), colour in zip(parts.items(), colours, strict=True):
        figure.add_bar(
            y=list(rows),
            x=short(lengths),
            name=name,
            orientation="h",
            marker={"color": colour, "line": {"width": 0}},
        )
    figure.update_yaxes(autorange="reversed", automargin=True)
    figure.update_layout(legend={"traceorder": "normal"}, margin={"t": legend})
    if share:
        figure.update_xaxes(range=[0, 1])
    return figure


def in_order(count: int, scale: str = "Viridis") -> list[str]:
    """Colours of things that follow one another."""
    # The scale's dark end is lost on dark pages.
    places = [0.5] if count == 1 else list(np.linspace(0.15, 0.93, count))
    return [str(colour) for colour in sample_colorscale(scale, places)]


def start_map(x: Floats, y: Floats, share: Floats, labels: tuple[str, str]) -> go.Figure:
    """Where episodes begin, and the share of the runs that succeed from there.

    Args:
        x: Of each start.
        y: Of each start.
        share: Of the runs of the row.
        labels: Of the axes.
    """
    order = np.argsort(-share, kind="stable")  # failures are drawn last, on top
    figure = blank(*labels, height=320)
    figure.add_scatter(
        x=short(x[order]),
        y=short(y[order]),
        mode="markers",
        marker={
            "color": short(share[order]),
            "colorscale": [[0.0, "#d1432f"], [0.5, "#e0a800"], [1.0, "#3b8ed0"]],
            "cmin": 0,
            "cmax": 1,
            "size": short(np.where(share[order] < 1, 8, 5)),
            "opacity": 0.75,
            "line": {"width": 0},
            "colorbar": {"thickness": 10, "tickvals": [0, 0.5, 1]},
        },
        hovertemplate="%{x:.3f}, %{y:.3f}: %{marker.color:.2f}<extra></extra>",
    )
    return figure


def binned_panel(
    bins: Mapping[str, tuple[Sequence[float], Sequence[float], Sequence[float], Sequence[float]]],
    places: Mapping[str, int],
    x: str,
) -> go.Figure:
    """Success over one axis of the start.

    Args:
        bins: Middles, shares, and bounds of their intervals, by row.
        places: Of the rows in the report.
        x: Label.
    """
    figure = blank(x, "share that succeeds", share=True)
    for name, (middles, shares, low, high) in bins.items():
        figure.add_scatter(
            x=short(middles),
            y=short(shares),
            name=name,
            mode="lines+markers",
            line={"color": COLOURS[places[name] % ROWS_A_PANEL], "width": 2},
            error_y={
                "type": "data",
                "symmetric": False,
                "array": short(np.subtract(high, shares)),
                "arrayminus": short(np.subtract(shares, low)),
                "thickness": 1,
                "width": 3,
            },
        )
    return figure


def heat_map(cells: Mapping[str, Sequence[tuple[str, float | None]]]) -> go.Figure:
    """Success by setting, a row for each kind of disturbance.

    Args:
        cells: Names and shares of the settings by kind; None is one that was not played.
    """
    most = max((len(row) for row in cells.values()), default=0)
    lacking = [[("", None)] * (most - len(row)) for row in cells.values()]
    rows = [[*row, *more] for row, more in zip(cells.values(), lacking, strict=True)]
    figure = blank("setting, from weak to strong", "", height=90 + LINE_PX * 2 * len(rows))
    figure.add_heatmap(
        z=[short([np.nan if share is None else share for _, share in row]) for row in rows],
        y=list(cells),
        text=[[_in_cell(*cell) for cell in row] for row in rows],
        texttemplate="%{text}",
        hoverinfo="text",
        colorscale=[[0.0, "#d1432f"], [0.5, "#e0a800"], [1.0, "#3b8ed0"]],
        zmin=0,
        zmax=1,
        colorbar={"thickness": 10, "tickvals": [0, 0.5, 1]},
    )
    figure.update_yaxes(autorange="reversed", automargin=True)
    figure.update_xaxes(showticklabels=False)
    return figure


def _in_cell(setting: str, share: float | None) -> str:
    if share is None:
        return f"{setting}<br>refused" if setting else ""
    return f"{setting}<br>{100 * share:.0f} %"


def _transparent(colour: str, alpha: float = 0.2) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"


def short(values: Any) -> list[float | None]:
    """Plain numbers with few digits; what is not finite is left out."""
    array = np.asarray(values, dtype=np.float64)
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in array]
