"""What is published of every task: the cells of the table over tasks, and the door's own rows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from statistics import fmean
from typing import Any

from docs.site.places import DOCS
from envs import find_task
from envs.reference import Column
from envs.registry import OURS
from pipeline.files.curves import WALL_S
from pipeline.results.cells import (
    CONDITIONS,
    FILE,
    FOLDER,
    OWN,
    Cell,
    Place,
    as_row,
    by_place,
    load_cells,
)
from pipeline.results.estimates import estimate
from pipeline.results.evaluation import Evaluation
from pipeline.results.rows import in_published_order, load_published, published_names
from pipeline.results.run_tables import cell
from pipeline.results.runs import EvaluatedRun, RunGroup

RESULTS = DOCS / "results"
REFERENCE = "reference.json"
DAPG = "DAPG's policy"


@cache
def listed() -> dict[Place, list[Cell]]:
    """The cells of ``cells.parquet``, by task, reward and row."""
    return by_place(load_cells(RESULTS / FOLDER / FILE))


@cache
def published() -> dict[Place, list[Cell]]:
    """Every published cell; where a row of the door's tables is listed too, that one counts."""
    of_tables = [_cell(row, run) for row in load_published(RESULTS) for run in row.runs]
    return by_place(of_tables) | listed()


@cache
def reference() -> dict[tuple[str, str], RunGroup]:
    """DAPG's own policies in our tasks, by task and reward (``python -m docs.lab.reference``)."""
    path = RESULTS / FOLDER / REFERENCE
    measured = json.loads(path.read_text())["tasks"] if path.is_file() else {}
    return {
        (task, reward): RunGroup(DAPG, (EvaluatedRun(path, _of_dapg(figures)),))
        for task, of_task in measured.items()
        for reward, figures in of_task.items()
    }


def rewards(task: str) -> tuple[str, ...]:
    """The rewards that have a column: those a task offers, else those that runs were paid."""
    if task in OURS:
        return find_task(task).rewards
    return tuple(sorted({reward for name, reward, _ in published() if name == task}))


def tasks() -> list[str]:
    """Ours in their order, then those of others."""
    others = {task for task, _, _ in published() if task not in OURS}
    return [*OURS, *sorted(others)]


def rows(task: str) -> list[str]:
    """Rows of a task's table: its own; of ours also those that another of ours has a cell of."""
    found = {row for name, _, row in published() if name == task}
    if task in OURS:
        found |= {row for name, _, row in listed() if name in OURS}
    return in_published_order(found, published_names())


def result(task: str, reward: str, row: str) -> RunGroup | None:
    """The seeds of a cell; None where it is missing."""
    found = published().get((task, reward, row))
    return None if found is None else as_row(found)


def condition(task: str, reward: str, row: str, name: str) -> float | None:
    """Mean over the seeds of a cell of one of its conditions; None if it is not told of all."""
    told = [found.conditions.get(name) for found in published().get((task, reward, row), [])]
    known = [float(value) for value in told if value is not None]
    return fmean(known) if known and len(known) == len(told) else None


def figures(row: RunGroup | None, columns: Sequence[Column]) -> list[str]:
    """Numbers of a cell with 95 % intervals (``estimates.HOW``); dashes where it is missing."""
    return [_figure(row, column) for column in columns]


def _of_dapg(figures: Mapping[str, Any]) -> Evaluation:
    return Evaluation.of({**figures, "made_from": {"run": DAPG, "variant": DAPG, "seed": 0}})


def middle(row: RunGroup | None, column: Column) -> str:
    """As :func:`figures`, without the interval."""
    found = None if row is None else estimate(row, column)
    return "-" if found is None else cell(column, found.value)


def _figure(row: RunGroup | None, column: Column) -> str:
    found = None if row is None else estimate(row, column)
    return "-" if found is None else found.text(column)


def _cell(row: RunGroup, run: EvaluatedRun) -> Cell:
    """A published run of a row, which knows no threads and may be older than the count of steps."""
    made_from = run.evaluation.made_from
    task = str(made_from.task_name)
    walls = [float(point[WALL_S]) for point in run.curve if point.get(WALL_S) is not None]
    told = {
        "preset": made_from.preset,
        "frames": made_from.frames,
        "simulator_steps": made_from.simulator_steps,
        "wall_s": max(walls, default=None),
        "demonstrations_multiplied": made_from.demos_multiplied,
        "git": made_from.versions.git if made_from.versions else None,
    }
    reward = (find_task(task).rewards or (OWN,))[0]
    return Cell(task, reward, row.name, dict.fromkeys(CONDITIONS) | told, run)


def variant(row: RunGroup) -> str:
    """The variant of which a row of results is."""
    return row.runs[0].evaluation.made_from.variant
