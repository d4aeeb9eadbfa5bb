"""What a note of the lab shows of its runs, and the index of the notes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from statistics import fmean

from docs.lab.data import load_rows
from docs.site.page import Page
from docs.site.places import DOCS
from docs.site.tables import code, table
from pipeline.results.run_tables import SPENT, spent
from pipeline.results.runs import EvaluatedRun, RunGroup

NOTES = DOCS / "lab" / "notes"
SUCCESS = "share_gt_1_35"
REACHED = 0.9
DECISIONS = ("adopted", "not adopted", "option", "lead", "finding")
"""What may become of a question: taken into the recipe, left, kept as an option that is off, open
until more seeds have run, or knowledge that changes nothing by itself."""


@cache
def rows() -> dict[str, RunGroup]:
    """The lab's rows by name."""
    return load_rows()


def notes() -> list[Page]:
    """Every note, by the number that its file's name begins with."""
    return [Page.read(path) for path in sorted(NOTES.glob("[0-9]*.md"))]


def index() -> str:
    """A table of all questions."""
    lines = (
        (f"[{note.title}](notes/{note.path.name})", note.about["decision"], _runs(note))
        for note in notes()
    )
    return table(("question", "decision", "runs"), lines)


def results(names: Sequence[str]) -> str:
    """The rows of a note: each with what its seeds reached.

    Raises:
        KeyError: The data hold no such row.
    """
    head = (
        "row", "seeds", *SPENT.values(), "> 1.35 rad", "worst seed", "return", "lowest after 90 %",
        "precision",
    )  # fmt: skip
    return table(head, (_line(rows()[name]) for name in names))


def data(names: Sequence[str]) -> str:
    """How the runs of a note are looked at again."""
    if not names:
        return "No run of this note was kept."
    listed = " ".join(names)
    return f"```\npython -m docs.lab.data export runs/lab {listed}\nmake report RUNS=runs/lab\n```"


def lowest(run: EvaluatedRun) -> float | None:
    """Least success of a run's evaluations after the first of 90 %; None without one."""
    shares = [float(point[SUCCESS]) for point in run.curve if point.get(SUCCESS) is not None]
    reached = next((k for k, share in enumerate(shares) if share >= REACHED), None)
    return None if reached is None else min(shares[reached:])


def _runs(note: Page) -> int:
    return sum(len(rows()[name].runs) for name in note.about.get("rows", []))


def _line(row: RunGroup) -> Sequence[object]:
    success = row.figures(SUCCESS)
    lows = [low for run in row.runs if (low := lowest(run)) is not None]
    made_from = (run.evaluation.made_from for run in row.runs)
    precisions = dict.fromkeys(told.precision or "" for told in made_from)
    return (
        code(row.name),
        len(row.runs),
        *spent(row.evaluations),
        f"{100 * fmean(success):.1f} %",
        f"{100 * min(success):.1f} %",
        f"{fmean(row.figures('return_mean')):,.0f}",
        f"{min(lows):.2f}" if lows else "",
        ", ".join(precisions),
    )
