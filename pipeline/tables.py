"""Tables I and II: a list of evaluated runs beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tabulate import tabulate


@dataclass(frozen=True)
class PaperRow:
    """One row of the paper's Tables I and II."""

    name: str
    return_mean: float
    angle_mean_deg: float
    angle_mean_deg_opened: float
    share_gt_0: float
    share_gt_0_2: float
    share_gt_1_0: float
    share_gt_1_35: float


PAPER: Mapping[str, PaperRow] = {
    "sac": PaperRow("SAC", 4.1, 2.2, 12.3, 0.182, 0.049, 0.010, 0.002),
    "bc": PaperRow("BC", 461.0, 41.1, 55.9, 0.736, 0.648, 0.349, 0.276),
    "bc_sac_0.1": PaperRow("BC-SAC (lambda = 0.1)", 65.3, 7.9, 51.1, 0.155, 0.118, 0.101, 0.0),
    "bc_sac_1": PaperRow("BC-SAC (lambda = 1)", 955.8, 83.1, 84.0, 0.989, 0.975, 0.925, 0.839),
    "bc_sac_10": PaperRow("BC-SAC (lambda = 10)", 868.8, 77.7, 81.3, 0.956, 0.938, 0.881, 0.780),
    "dbc_sac": PaperRow("DBC-SAC", 966.7, 86.4, 86.5, 0.999, 0.993, 0.982, 0.948),
    "sid_bc": PaperRow("SID-BC-SAC", 910.7, 82.0, 82.7, 0.991, 0.990, 0.982, 0.935),
    "sid_dbc": PaperRow("SID-DBC-SAC", 966.8, 86.7, 86.7, 1.0, 1.0, 0.999, 0.971),
    "ila_bc": PaperRow("ILD-BC-SAC", 704.5, 62.1, 62.3, 0.966, 0.951, 0.425, 0.361),
    "ila_dbc": PaperRow("ILD-DBC-SAC", 614.0, 54.3, 56.2, 0.997, 0.962, 0.555, 0.420),
    "da_sac": PaperRow("DA-SAC", 46.0, 5.2, 11.0, 0.479, 0.117, 0.008, 0.0),
}
"""Tables I and II of the paper by variant (BC-SAC also by lambda): 1000 doors, one run each."""

TABLE_1 = {
    "return": "return_mean",
    "angle (deg)": "angle_mean_deg",
    "opened only": "angle_mean_deg_opened",
}
TABLE_2 = {
    "> 0 rad": "share_gt_0",
    "> 0.2": "share_gt_0_2",
    "> 1.0": "share_gt_1_0",
    "> 1.35": "share_gt_1_35",
}
FAMILY_WITH_LAMBDA = "bc_sac"


def paper_row(variant: str, bc_weight: float | None) -> PaperRow | None:
    """The paper's row for a run, or None if it has none (own variants, other lambdas)."""
    if variant == FAMILY_WITH_LAMBDA:
        return PAPER.get(f"{variant}_{bc_weight:g}") if bc_weight is not None else None
    return PAPER.get(variant)


def render(evaluations: Sequence[Mapping[str, Any]]) -> str:
    """Tables I and II in Markdown; every column is "ours / paper's".

    Args:
        evaluations: Contents of ``evaluation.json`` files of door runs.

    Raises:
        ValueError: If an evaluation lacks a column, e.g. because it is of another task.
    """
    return "\n\n".join(
        f"**{title}** (ours / paper)\n\n{_table(evaluations, columns)}"
        for title, columns in (
            ("Table I: return and largest door angle", TABLE_1),
            ("Table II: share of doors opened beyond", TABLE_2),
        )
    )


def _table(evaluations: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    rows = []
    for evaluation in evaluations:
        made_from = evaluation["made_from"]
        reference = paper_row(made_from["variant"], made_from.get("bc_weight"))
        row = [made_from["variant"], made_from["seed"], evaluation["episodes"]]
        for key in columns.values():
            if key not in evaluation:
                raise ValueError(
                    f"{made_from['run']}: its evaluation has no {key!r}; only door runs have a "
                    "place in Tables I and II."
                )
            theirs = getattr(reference, key) if reference is not None else None
            row.append(f"{cell(key, evaluation[key])} / {cell(key, theirs)}")
        rows.append(row)
    return tabulate(rows, headers=["variant", "seed", "doors", *columns], tablefmt="github")


def cell(key: str, value: float | None) -> str:
    """A number of column ``key`` as the tables show it; None as a dash."""
    if value is None:
        return "-"
    return f"{100 * value:.1f} %" if key.startswith("share") else f"{value:.1f}"
