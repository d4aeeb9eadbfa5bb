"""A task's tables over several seeds, beside its published rows."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

from tabulate import tabulate

from envs.reference import Column, Reference
from pipeline.results.run_tables import cell, reference_row
from pipeline.results.runs import RunGroup
from pipeline.results.statistics import Estimate, interquartile_means


def render_rows(rows: Sequence[RunGroup], reference: Reference) -> str:
    """The task's tables in Markdown: interquartile mean [95 % interval] over seeds / published.

    A row with one seed has no interval; a cell without a value in some seed (none got so far) shows
    none.
    """
    return "\n\n".join(
        f"**{title}** (ours, IQM over seeds with 95 % interval / {reference.source})\n\n"
        + _table(rows, columns, reference)
        for title, columns in reference.tables.items()
    )


def render_summary(rows: Sequence[RunGroup], reference: Reference) -> str:
    """The return and the last table in Markdown: mean over seeds / published, where it is.

    The README shows it; means, because a seed that fails must show.
    """
    first, *_, last = reference.tables.values()
    columns = (first[0], *last)
    lines = [
        [
            f"`{row.name}`",
            len(row.runs),
            *(
                cell(column, _mean(row, column.key)) + (f" / {theirs}" if theirs != "-" else "")
                for column in columns
                for theirs in [_theirs(row, column, reference)]
            ),
        ]
        for row in rows
    ]
    return tabulate(lines, headers=_headers(columns), tablefmt="github")


def _mean(row: RunGroup, key: str) -> float | None:
    """Over seeds; None if an evaluation does not tell."""
    figures = row.figures(key)
    return fmean(figures) if figures else None


def _theirs(row: RunGroup, column: Column, reference: Reference) -> str:
    made_from = row.runs[0].evaluation.made_from
    theirs = reference_row(reference, made_from.variant, made_from.bc_weight) or {}
    return cell(column, theirs.get(column.key))


def _table(rows: Sequence[RunGroup], columns: Sequence[Column], reference: Reference) -> str:
    lines = []
    for row in rows:
        cells = [_cell(row, column, reference) for column in columns]
        lines.append([row.name, len(row.runs), *cells])
    return tabulate(lines, headers=_headers(columns), tablefmt="github")


def _headers(columns: Sequence[Column]) -> list[str]:
    return ["row", "seeds", *(column.header for column in columns)]


def _cell(row: RunGroup, column: Column, reference: Reference) -> str:
    figures, theirs = row.figures(column.key), _theirs(row, column, reference)
    if not figures:
        return f"- / {theirs}"
    if len(figures) == 1:  # an interval would pretend that there are others
        return f"{cell(column, figures[0])} / {theirs}"
    estimate: Estimate = interquartile_means({row.name: [[v] for v in figures]})[row.name]
    low, high = (cell(column, float(bound[0])) for bound in (estimate.low, estimate.high))
    return f"{cell(column, float(estimate.iqm[0]))} [{low}, {high}] / {theirs}"
