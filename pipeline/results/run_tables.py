"""Evaluated runs beside the published rows of their task."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean

import numpy as np
from tabulate import tabulate

from envs import registry
from envs.intervals import wilson
from envs.reference import Column, Reference
from envs.task import MissingCapabilityError
from pipeline.files.run_files import TRUST, RunDirectoryError
from pipeline.results.evaluation import Evaluation

RETURN = "return_mean"
SPENT = {"frames": "frames", "simulator_steps": "simulator steps"}
"""What a run cost, as its evaluation tells it, and the headers of tables."""
NORMAL_95 = 1.959964
"""Deviations of a normal distribution within which 95 % lie."""


def reference_row(
    reference: Reference, variant: str, bc_weight: float | None
) -> Mapping[str, float] | None:
    """The published row of a run, or None (own variants, other weights)."""
    return reference.rows.get(row_name(variant, bc_weight, reference.rows))


def row_name(variant: str, bc_weight: float | None, names: Iterable[str]) -> str:
    """What a run's row is called among ``names``.

    Its variant; with its weight behind it where there are rows of several weights, of which only
    that of this one is its.
    """
    several = any(_has_weight(name, variant) for name in names)
    return f"{variant}_{bc_weight:g}" if several and bc_weight is not None else variant


def render(evaluations: Sequence[Evaluation], reference: Reference) -> str:
    """The task's tables in Markdown; every column is "ours / published".

    Args:
        evaluations: Of runs of the task.
        reference: Of the task.

    Raises:
        ValueError: If an evaluation lacks a column, e.g. because it is of another task.
    """
    return "\n\n".join(
        f"**{title}** (ours with the 95 % interval over episodes / {reference.source})\n\n"
        + _table(evaluations, columns, reference)
        for title, columns in reference.tables.items()
    )


def reference_of(evaluations: Sequence[Evaluation]) -> Reference:
    """The published rows of the task that all evaluations are of.

    Raises:
        ValueError: If they are of several tasks.
        RunDirectoryError: If the task is somebody's code, which only the evaluations name.
        MissingCapabilityError: If the task has no published rows.
    """
    tasks = {str(evaluation.made_from.task_name) for evaluation in evaluations}
    if len(tasks) != 1:
        raise ValueError(f"a table is of one task, and these runs are of {sorted(tasks)}")
    name = tasks.pop()
    if registry.imports_of(name) and os.environ.get(TRUST) != "1":
        raise RunDirectoryError(
            f"{evaluations[0].made_from.run}: its evaluation is of task {name!r}, whose published "
            f"rows cannot be looked up without running its code. If you trust it, set {TRUST}=1"
        )
    reference = registry.reference_of(name)
    if reference is None:
        raise MissingCapabilityError(
            f"make table sets runs beside published rows, and task {name} has none (the "
            "`reference` of a Task, envs/reference.py): of any task, make report RUNS=... sets "
            "runs beside one another"
        )
    return reference


def _table(
    evaluations: Sequence[Evaluation], columns: Sequence[Column], reference: Reference
) -> str:
    rows = []
    for evaluation in evaluations:
        made_from = evaluation.made_from
        theirs = reference_row(reference, made_from.variant, made_from.bc_weight) or {}
        row: list[object] = [made_from.variant, made_from.seed, evaluation.episodes]
        row += spent([evaluation])
        for column in columns:
            if column.key not in evaluation.content:
                raise ValueError(
                    f"{made_from.run}: its evaluation has no {column.key!r}; only runs of the "
                    "same task have a place in its tables."
                )
            value = evaluation.figure(column.key)
            interval = over_episodes(evaluation, column)
            ours = cell(column, None) if value is None else with_interval(column, value, interval)
            row.append(f"{ours} / {cell(column, theirs.get(column.key))}")
        rows.append(row)
    headers = ["variant", "seed", "episodes", *SPENT.values(), *(c.header for c in columns)]
    return tabulate(rows, headers=headers, tablefmt="github")


def spent(evaluations: Sequence[Evaluation]) -> list[str]:
    """The cells under ``SPENT``: means over runs.

    A dash where a run does not tell, which is not 0: simulator steps were not always counted.
    """
    told = [[getattr(one.made_from, key) for one in evaluations] for key in SPENT]
    return [f"{fmean(v):,.0f}" if v and None not in v else "-" for v in told]


def over_episodes(evaluation: Evaluation, column: Column) -> tuple[float, float] | None:
    """95 % interval of a figure over the episodes of an evaluation; None where none can be told.

    Wilson's of a share, the normal one of the return. It says nothing about other seeds.
    """
    value, episodes = evaluation.figure(column.key), evaluation.episodes
    if value is None:
        return None
    if column.percent:
        return wilson(np.arange(episodes) < round(episodes * value))
    if column.key == RETURN and evaluation.return_std is not None:
        half = NORMAL_95 * evaluation.return_std / math.sqrt(episodes)
        return value - half, value + half
    return None


def with_interval(column: Column, value: float, interval: tuple[float, float] | None) -> str:
    """A number and its interval as the tables show them."""
    if interval is None:
        return cell(column, value)
    scale = 100.0 if column.percent else 1.0
    low, high = (f"{scale * bound:.1f}" for bound in interval)
    return f"{cell(column, value)} [{low}, {high}]"


def cell(column: Column, value: float | None) -> str:
    """A number as the tables show it; None as a dash."""
    if value is None:
        return "-"
    return f"{100 * value:.1f} %" if column.percent else f"{value:.1f}"


def _has_weight(name: str, variant: str) -> bool:
    prefix, _, weight = name.rpartition("_")
    try:
        float(weight)
    except ValueError:
        return False
    return prefix == variant
