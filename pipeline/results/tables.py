"""Tables I and II over several seeds, beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean

from tabulate import tabulate

from pipeline.results.rows import ResultRow
from pipeline.results.statistics import Estimate, interquartile_means
from pipeline.tables import TABLE_1, TABLE_2, cell, paper_row


def render_rows(rows: Sequence[ResultRow]) -> str:
    """Both tables in Markdown: interquartile mean [95 % interval] over seeds / the paper's number.

    A row with one seed has no interval; a cell without a value in some seed (no door opened) shows
    none.
    """
    tables = (
        ("Table I: return and largest door angle", TABLE_1),
        ("Table II: share of doors opened beyond", TABLE_2),
    )
    return "\n\n".join(
        f"**{title}** (ours, IQM over seeds with 95 % interval / paper)\n\n{_table(rows, columns)}"
        for title, columns in tables
    )


def render_summary(rows: Sequence[ResultRow]) -> str:
    """Table II and the return in Markdown: mean over seeds / the paper's number, where it has one.

    The README shows it; means, because a seed that fails must show.
    """
    columns = {"return": TABLE_1["return"], **TABLE_2}
    lines = [
        [
            f"`{row.name}`",
            len(row.seeds),
            *(
                cell(key, fmean(row.figures(key))) + (f" / {theirs}" if theirs != "-" else "")
                for key in columns.values()
                for theirs in [_theirs(row, key)]
            ),
        ]
        for row in rows
    ]
    return tabulate(lines, headers=["row", "seeds", *columns], tablefmt="github")


def _theirs(row: ResultRow, key: str) -> str:
    made_from = row.seeds[0].evaluation["made_from"]
    reference = paper_row(made_from["variant"], made_from.get("bc_weight"))
    return cell(key, None if reference is None else getattr(reference, key))


def _table(rows: Sequence[ResultRow], columns: Mapping[str, str]) -> str:
    lines = []
    for row in rows:
        cells = [_cell(row, key) for key in columns.values()]
        lines.append([row.name, len(row.seeds), *cells])
    return tabulate(lines, headers=["row", "seeds", *columns], tablefmt="github")


def _cell(row: ResultRow, key: str) -> str:
    theirs = _theirs(row, key)
    if any(seed.evaluation.get(key) is None for seed in row.seeds):
        return f"- / {theirs}"
    if len(row.seeds) == 1:  # an interval would pretend that there are others
        return f"{cell(key, row.figures(key)[0])} / {theirs}"
    estimate: Estimate = interquartile_means({row.name: [[v] for v in row.figures(key)]})[row.name]
    low, high = (cell(key, float(bound[0])) for bound in (estimate.low, estimate.high))
    return f"{cell(key, float(estimate.iqm[0]))} [{low}, {high}] / {theirs}"
