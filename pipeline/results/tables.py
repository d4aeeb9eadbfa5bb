"""A task's tables over several seeds, beside its published rows."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

from tabulate import tabulate

from envs.reference import Column, Reference
from pipeline.results.estimates import estimate
from pipeline.results.run_tables import SPENT, cell, reference_row, spent
from pipeline.results.runs import RunGroup


def render_rows(rows: Sequence[RunGroup], reference: Reference) -> str:
    """The task's tables in Markdown: estimate [95 % interval] / published, see ``estimates.HOW``.

    A cell without a value in some seed (none got so far) shows none.
    """
    return "\n\n".join(
        f"**{title}** (ours with 95 % interval / {reference.source})\n\n"
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
            *spent(row.evaluations),
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
        lines.append([row.name, len(row.runs), *spent(row.evaluations), *cells])
    return tabulate(lines, headers=_headers(columns), tablefmt="github")


def _headers(columns: Sequence[Column]) -> list[str]:
    return ["row", "seeds", *SPENT.values(), *(column.header for column in columns)]


def _cell(row: RunGroup, column: Column, reference: Reference) -> str:
    ours = estimate(row, column)
    return f"{'-' if ours is None else ours.text(column)} / {_theirs(row, column, reference)}"
