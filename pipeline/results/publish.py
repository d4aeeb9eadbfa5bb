"""``make results``: evaluated runs in, everything below ``docs/results`` out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from envs.whole_files import whole_set
from pipeline.files.run_files import EVALUATION, as_json, write_atomically
from pipeline.results.cells import OWN
from pipeline.results.curves import AXES
from pipeline.results.export import POLICIES, export_middle
from pipeline.results.plots import plot_curves, plot_diagnostics
from pipeline.results.reading import ROWS, SEED
from pipeline.results.rows import (
    in_published_order,
    load_published,
    load_rows,
    merge_rows,
)
from pipeline.results.run_cells import require_revisions, reward_of, task_of_ours
from pipeline.results.run_tables import reference_of
from pipeline.results.runs import RunGroup
from pipeline.results.tables import render_rows, render_summary
from pipeline.run_dir import saved_recipe

TABLE = "table.json"
TABLES = "tables.md"
SUMMARY = "summary.md"
"""The short table that the README shows."""


def publish(
    runs: Path, out: Path, *, policies: bool = True, unclean: bool = False
) -> list[RunGroup]:
    """Writes tables, per-seed files, figures and one policy per row.

    Seeds that ``out`` holds already stay and count, so that five seeds of a row may come from
    machines and days of which no run directory is left. A row's policy is the one in the
    middle by success, then return, among those whose weights are at hand: below ``runs``, or
    published earlier.

    Args:
        runs: Holds ``ROW/seedN`` run directories.
        out: Folder, e.g. ``docs/results``.
        policies: Whether policies are written.
        unclean: Whether files that no revision holds may have been at work.

    Returns:
        The rows, in the order of the tables.

    Raises:
        RunDirectoryError: If there is nothing to publish, something cannot be read, a row would
            mix recipes, or a run names no revision; nothing is written then.
        FileNotFoundError, ValueError: If the weights of a policy are missing or damaged; likewise.
    """
    new = load_rows(runs)
    for run in () if unclean else (run for row in new for run in row.runs):
        require_revisions(run)
    rows = merge_rows(load_published(out), new)
    reference = reference_of([run.evaluation for row in rows for run in row.runs])
    names = in_published_order((row.name for row in rows), reference.rows)
    rows.sort(key=lambda row: names.index(row.name))
    changed = {row.name for row in new}
    with whole_set(out) as made:
        for row in (row for row in rows if row.name in changed):
            folder = made / ROWS / row.name
            folder.mkdir(parents=True)
            for run in row.runs:
                write_atomically(folder / f"seed{run.seed}.json", _compact(run.published()))
            drawn = [run for run in row.runs if run.curve]
            if drawn:
                title = f"{row.name}: {len(drawn)} seeds"
                plot_diagnostics(title, drawn, folder / "diagnostics.png")
            if policies:
                export_middle(row, out / POLICIES, row.name, made=made / POLICIES)
        for x in AXES:
            plot_curves(rows, x, made / f"curves_{x.key}.png")
        write_atomically(made / TABLE, as_json(table(rows), indent=1) + "\n")
        write_atomically(made / TABLES, render_rows(rows, reference) + "\n")
        write_atomically(made / SUMMARY, render_summary(rows, reference) + "\n")
    return rows


def has_tables(runs: Path) -> bool:
    """Whether a folder holds ``ROW/seedN`` of a task with published tables, by its own reward.

    Of others there is a table over tasks (:mod:`pipeline.results.publish_cells`).
    """
    evaluated = [path.parent for path in runs.glob(f"*/{SEED}*/{EVALUATION}")]
    if not evaluated:
        return False
    recipes = [saved_recipe(run) for run in evaluated]
    kinds = {(recipe.task.name, reward_of(recipe)) for recipe in recipes}
    task = task_of_ours(recipes[0])
    if len(kinds) > 1 or task is None or task.reference is None:
        return False
    return reward_of(recipes[0]) in (OWN, *task.rewards[:1])


def table(rows: Sequence[RunGroup]) -> dict[str, Any]:
    """``table.json``: for each row its frames, its preset and the evaluation of every seed."""
    return {
        row.name: {
            "frames": row.runs[0].evaluation.made_from.frames,
            "preset": row.runs[0].evaluation.made_from.preset,
            "seeds": [_figures(run.published()) for run in row.runs],
        }
        for row in rows
    }


def _figures(published: dict[str, Any]) -> dict[str, Any]:
    kept = {k: v for k, v in published.items() if k not in {"curve", "alarms", "made_from"}}
    return {"seed": published["made_from"]["seed"], **kept}


def _compact(content: dict[str, Any]) -> str:
    """One line for each entry, so that curves stay readable in a diff."""
    lines = (f"{json.dumps(key)}: {as_json(value)}" for key, value in content.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"
