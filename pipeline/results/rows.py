"""Runs of one row of the tables, one per seed: run directories, and the files published of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

from envs import find_task
from envs.registry import OURS
from pipeline.files.run_files import EVALUATION, RunDirectoryError
from pipeline.results.evaluation_files import load_evaluation
from pipeline.results.grouping import RECIPE
from pipeline.results.reading import ROWS, SEED, load_run, parse_published
from pipeline.results.runs import EvaluatedRun, RunGroup

BEFORE_IT_WAS_NAMED = {"noise_scale": 1.0}
"""What held for evaluations that are older than a key of ``RECIPE``."""


@cache
def published_names() -> tuple[str, ...]:
    """Names of the rows that are published of a task of this project, in their order.

    In a table over tasks a row has one name at every task, published there or not.
    """
    references = (find_task(name).reference for name in OURS)
    rows = (row for found in references if found is not None for row in found.rows)
    return tuple(dict.fromkeys(rows))


def in_published_order(names: Iterable[str], published: Iterable[str]) -> list[str]:
    """Names of rows in the order in which they were published, our own behind them by name."""
    places = {name: place for place, name in enumerate(published)}
    return sorted(names, key=lambda name: (places.get(name, len(places)), name))


def load_rows(folder: Path) -> list[RunGroup]:
    """Reads ``folder/ROW/seedN`` of all rows; runs that are not evaluated yet are left out.

    Raises:
        RunDirectoryError: If there is no evaluated run, or one cannot be read.
    """
    rows = []
    for row_dir in sorted(path for path in folder.glob("*") if path.is_dir()):
        runs = sorted(run for run in row_dir.glob(f"{SEED}*") if (run / EVALUATION).is_file())
        if runs:
            rows.append(_in_order(row_dir.name, [load_run(run) for run in runs]))
    if not rows:
        raise RunDirectoryError(
            f"{folder} holds no evaluated run ROW/{SEED}N/{EVALUATION}; make them with: make rows"
        )
    return rows


def load_published(folder: Path) -> list[RunGroup]:
    """Reads what :func:`~pipeline.results.publish.publish` wrote to ``folder``; it may be nothing.

    Raises:
        RunDirectoryError: If a file is damaged.
    """
    rows: dict[str, list[EvaluatedRun]] = {}
    for path in sorted((folder / ROWS).glob(f"*/{SEED}*.json")):
        run = parse_published(path, load_evaluation(path).content)
        rows.setdefault(path.parent.name, []).append(run)
    return [_in_order(name, runs) for name, runs in rows.items()]


def _in_order(name: str, runs: Iterable[EvaluatedRun]) -> RunGroup:
    return RunGroup(name, tuple(sorted(runs, key=lambda run: run.seed)))


def merge_rows(earlier: Sequence[RunGroup], later: Sequence[RunGroup]) -> list[RunGroup]:
    """All seeds of both; where both have a seed of a row, the later one counts.

    Raises:
        RunDirectoryError: If a row that gains seeds would hold those of different recipes.
    """
    rows: dict[str, dict[int, EvaluatedRun]] = {}
    for row in (*earlier, *later):
        rows.setdefault(row.name, {}).update({run.seed: run for run in row.runs})
    merged = [_in_order(name, runs.values()) for name, runs in rows.items()]
    added = {row.name for row in later}
    for row in merged:
        if row.name in added:
            difference = recipe_difference(row)
            if difference is not None:
                raise RunDirectoryError(
                    f"{difference}; publish to another folder (OUT=...), or remove "
                    f"{ROWS}/{row.name} from this one"
                )
    return merged


def recipe_difference(row: RunGroup) -> str | None:
    """In what two seeds of a row are of different recipes; None if they are of one."""
    first, *others = ({**BEFORE_IT_WAS_NAMED, **run.published()["made_from"]} for run in row.runs)
    for other in others:
        for key in RECIPE:
            if other.get(key) != first.get(key):
                return (
                    f"row {row.name}: seed {first['seed']} has {key} {first.get(key)!r}, "
                    f"seed {other['seed']} has {other.get(key)!r}"
                )
    return None
