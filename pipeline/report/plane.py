"""Two qualities of several rows against each other."""

from __future__ import annotations

from collections.abc import Mapping

import plotly.graph_objects as go

from pipeline.report.charts import blank, in_order, short

Spread = tuple[float, float, float]
"""10, 50 and 90 % quantile."""


def plane(
    x: Mapping[str, Spread | None], y: Mapping[str, Spread | None], labels: tuple[str, str]
) -> go.Figure:
    """A point for each row at its medians, with bars to the other quantiles.

    Args:
        x: By name of the row; a row without one of the two is left out.
        y: Likewise.
        labels: Of the axes.
    """
    figure = blank(*labels, height=380, showlegend=False)
    for (name, across), colour in zip(x.items(), in_order(len(x), "Turbo"), strict=True):
        up = y.get(name)
        if across is None or up is None:
            continue
        bar = {"type": "data", "symmetric": False, "thickness": 1, "width": 3}
        figure.add_scatter(
            x=short([across[1]]),
            y=short([up[1]]),
            name=name,
            text=[name],
            mode="markers+text",
            textposition="top right",
            marker={"color": colour, "size": 9},
            error_x={
                **bar,
                "array": short([across[2] - across[1]]),
                "arrayminus": short([across[1] - across[0]]),
            },
            error_y={
                **bar,
                "array": short([up[2] - up[1]]),
                "arrayminus": short([up[1] - up[0]]),
            },
        )
    return figure
