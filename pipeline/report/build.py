"""From paths of runs to ``index.html`` and ``report.md``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from envs import Task, find_task
from envs.registry import imports_of
from pipeline.files.run_files import write_atomically
from pipeline.report import episodes, learning, manner, summary
from pipeline.report.films import films
from pipeline.report.page import Report
from pipeline.results.grouping import group
from pipeline.results.reading import read_runs
from pipeline.results.runs import RunGroup

PAGE = "index.html"
MARKDOWN = "report.md"


def write_report(paths: Sequence[Path], out: Path, only: Sequence[str] = ()) -> Report:
    """Writes the report of all runs that ``paths`` lead to into the folder ``out``.

    Args:
        paths: Of runs.
        out: Folder; it is made.
        only: Keys of the sections to keep; none keeps all.

    Raises:
        RunDirectoryError: If a path leads to no run.
        ValueError: If the runs are of several tasks, or have no section of such a key.
    """
    report = _kept(build_report(group(read_runs(paths))), only)
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / PAGE, report.html())
    write_atomically(out / MARKDOWN, report.markdown())
    return report


def build_report(rows: Sequence[RunGroup]) -> Report:
    """The report of these rows.

    Raises:
        ValueError: If they are of several tasks.
    """
    told = (run.told("task") for row in rows for run in row.runs)
    names = {str(name): None for name in told if name is not None}
    if len(names) > 1:
        raise ValueError(f"a report is of one task, and these runs are of {sorted(names)}")
    name = next(iter(names), "a task that no run names")
    task = _task(name)
    reference = None if task is None else task.reference
    if reference is not None:  # in the order in which they were published, our own behind them
        order = list(reference.rows)
        rows = sorted(
            rows, key=lambda row: order.index(row.name) if row.name in order else len(order)
        )
    sections = (
        summary.missing(rows),
        summary.headline(rows, reference),
        learning.curves(rows, reference),
        episodes.stages(rows),
        episodes.maps(rows, task),
        episodes.times(rows),
        episodes.progress(rows, task),
        films(rows),
        manner.strategies(rows),
        summary.alike(rows),
        manner.robustness(rows),
        learning.diagnostics(rows),
        learning.wall_time(rows),
        summary.differences(rows),
        summary.provenance(rows),
    )
    runs = sum(len(row.runs) for row in rows)
    evaluated = sum(len(row.evaluations) for row in rows)
    return Report(
        title=f"{Path(name).name}: {_counted(len(rows), 'row')}",
        summary=f"Task {Path(name).name}; {_counted(runs, 'run')}, {evaluated} of them evaluated.",
        sections=[section for section in sections if section is not None],
    )


def _kept(report: Report, only: Sequence[str]) -> Report:
    keys = [section.key for section in report.sections]
    unknown = [key for key in only if key not in keys]
    if unknown:
        known = ", ".join(keys)
        raise ValueError(f"ONLY={unknown[0]} is no section of this report; it has {known}")
    kept = [section for section in report.sections if not only or section.key in only]
    return replace(report, sections=kept)


def _task(name: str) -> Task | None:
    """The task, if it can be found without running code that only a run names."""
    try:
        return None if imports_of(name) else find_task(name)
    except (ValueError, ImportError):
        return None


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
