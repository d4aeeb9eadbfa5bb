"""Sections of the report that say what came out, how the runs differ and where numbers are from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envs.reference import Column, Reference
from pipeline.files import again
from pipeline.report.charts import chart
from pipeline.report.learning import never_learned, published
from pipeline.report.page import Section, Table
from pipeline.report.plane import Spread, plane
from pipeline.results.estimates import HOW, estimate
from pipeline.results.evaluation import Movement, Versions
from pipeline.results.grouping import different, recipe
from pipeline.results.run_tables import RETURN, SPENT, cell, spent
from pipeline.results.runs import EvaluatedRun, RunGroup

HEADLINE = (
    Column("success_once", "success", percent=True),
    Column("success_at_end", "success at the end", percent=True),
    Column(RETURN, "return"),
    Column("steps_to_success_median", "steps to success, median"),
)
"""Of every task."""
HASH_DIGITS = 10


def headline(rows: Sequence[RunGroup], reference: Reference | None) -> Section:
    """What came out: the figures of every task, then the task's published tables beside ours."""
    source = "published" if reference is None else reference.source
    tables = [_beside(rows, HEADLINE, reference)]
    if reference is not None:
        tables += [
            _beside(rows, columns, reference, title) for title, columns in reference.tables.items()
        ]
    text = HOW if reference is None else f"{HOW} Behind the stroke: {source}."
    absent = [f"{row.name}: no run is evaluated" for row in rows if not row.evaluations]
    return Section("results", "Results", text, tables=tables, absent=absent)


def _beside(
    rows: Sequence[RunGroup],
    columns: Sequence[Column],
    reference: Reference | None,
    title: str = "",
) -> Table:
    lines = []
    for row in rows:
        found = []
        for column in columns:
            theirs = published(row, column.key, reference)
            ours = estimate(row, column)
            text = "-" if ours is None else ours.text(column)
            found.append(text if theirs is None else f"{text} / {cell(column, theirs)}")
        counts = [str(len(row.evaluations)), _episodes(row), *spent(row.evaluations)]
        lines.append([row.name, *found, *counts])
    # What came out stands first: a phone shows two columns or three.
    headers = ["row", *(c.header for c in columns), "seeds", "episodes", *SPENT.values()]
    return Table(headers, lines, title)


def _episodes(row: RunGroup) -> str:
    counts = sorted({int(count) for count in row.figures("episodes")})
    return " to ".join(str(count) for count in {counts[0]: 0, counts[-1]: 0}) if counts else "-"


ALIKE = (
    ("path_distance", "path, cm from the nearest", 100.0),
    ("posture_distance", "posture, rad from the nearest", 1.0),
    ("steps", "steps", 1.0),
    ("speed_mean", "speed, m/s", 1.0),
    ("jerk_mean", "jerk, m/s^3", 1.0),
    ("log_dimensionless_jerk", "log dimensionless jerk", 1.0),
    ("saturated_actions", "saturated actions, %", 100.0),
)
"""Figure of ``likeness``, header, and what turns its unit into the header's."""


def alike(rows: Sequence[RunGroup]) -> Section | None:
    """How alike the movements are to demonstrations; None if no evaluation compared them."""
    shown: dict[str, list[Movement]] = {}
    own: dict[str, list[Movement]] = {}
    for row in rows:
        for told in filter(None, (evaluation.likeness for evaluation in row.evaluations)):
            shown.setdefault(f"demonstrations: {told.to}", [told.of_demonstrations])
            own.setdefault(row.name, []).append(told)
    if not own:
        return None
    everything = {**shown, **own}
    return Section(
        "likeness",
        "Likeness to the demonstrations",
        "Median [10, 90 %] over episodes, up to the first success; means over seeds. Distances are "
        "to the nearest demonstration, by dynamic time warping, and of a demonstration to the "
        "nearest other one. Further left is faster, further down more alike.",
        tables=[
            Table(
                ["movements", *(header for _, header, _ in ALIKE)],
                [[name, *_alike(found)] for name, found in everything.items()],
            )
        ],
        charts=[
            chart(
                "speed against likeness",
                plane(
                    {name: _quantiles(found, "steps") for name, found in everything.items()},
                    {
                        name: _quantiles(found, "path_distance")
                        for name, found in everything.items()
                    },
                    ("steps until success", "path, cm from the nearest demonstration"),
                ),
                wide=True,
            )
        ],
    )


def _quantiles(found: Sequence[Movement], key: str) -> Spread | None:
    """10, 50 and 90 % over episodes, means over seeds, in the table's unit; None if unknown."""
    known = [spread for of_one in found if (spread := getattr(of_one, key)) is not None]
    if not known:
        return None
    low, middle, high = {key: scale for key, _, scale in ALIKE}[key] * np.mean(known, axis=0)
    return float(low), float(middle), float(high)


def _alike(found: Sequence[Movement]) -> list[str]:
    cells = []
    for key, _, _ in ALIKE:
        known = _quantiles(found, key)
        cells.append("-" if known is None else "{1:.3g} [{0:.3g}, {2:.3g}]".format(*known))
    return cells


def differences(rows: Sequence[RunGroup]) -> Section:
    """Keys of the recipes in which the rows differ, and those in which seeds of one row do."""
    recipes = {row.name: [recipe(run) for run in row.runs] for row in rows}
    keys = different([values for of_row in recipes.values() for values in of_row])
    lines = [
        [key, *(_values([run.get(key) for run in of_row]) for of_row in recipes.values())]
        for key in keys
    ]
    whole = all(run.settings for row in rows for run in row.runs)
    return Section(
        "differences",
        "Differences of configuration",
        "Keys that do not have the same value everywhere, but seeds and what is the machine's.",
        tables=[Table(["key", *recipes], lines)] if lines else [],
        absent=[
            *([] if lines else ["none"]),
            *([] if whole else ["of runs without config.yaml, only what an evaluation records"]),
        ],
    )


def _values(values: Sequence[Any]) -> str:
    told = {str(value): None for value in values}
    return " | ".join("-" if value == "None" else value for value in told)


def provenance(rows: Sequence[RunGroup]) -> Section:
    """Where every number is from."""
    lines = [_origin(row, run) for row in rows for run in row.runs]
    packages = {name: None for row in rows for run in row.runs for name in _packages(run)}
    versions = [
        [run.name, *(str(_packages(run).get(name) or "-") for name in packages)]
        for row in rows
        for run in row.runs
    ]
    tables = [Table(ORIGIN, lines, "Runs")]
    if packages:
        tables.append(Table(["run", *packages], _once(versions), "Packages at the evaluation"))
    return Section(
        "provenance",
        "Where the numbers are from",
        "An asterisk: the working tree had changes that no revision holds. The SHA-256 is of the "
        "file of demonstrations at the evaluation.",
        tables=tables,
    )


ORIGIN = (
    "run", "row", "seed", "checkpoint", "frames", "simulator steps", "again with",
    "revision of the evaluation", "of the training", "evaluation seed", "demonstrations",
    "SHA-256", "machine",
)  # fmt: skip


def _origin(row: RunGroup, run: EvaluatedRun) -> list[str]:
    made_from = run.made_from
    versions = _versions(run)
    demos = run.told("demos")
    sha = None if made_from is None else made_from.demos_sha256
    return [
        run.name,
        row.name,
        _or_dash(run.told("seed")),
        _or_dash(None if made_from is None else made_from.checkpoint),
        _or_dash(None if made_from is None else made_from.frames),
        _or_dash(None if made_from is None else made_from.simulator_steps),
        _command(run),
        _revision(versions),
        _revision(run.versions),
        _or_dash(None if made_from is None else made_from.evaluation_seed),
        "-" if demos is None else Path(demos).name,
        "-" if sha is None else sha[:HASH_DIGITS],
        _or_dash(versions.machine or run.versions.machine),
    ]


def _command(run: EvaluatedRun) -> str:
    if run.evaluation_or_none is None:
        return again.evaluate(run.path)
    if run.path.is_file():
        return "-"  # published figures: no policy to play
    of_config = {
        key.removeprefix(again.TASK): value
        for key, value in run.settings.items()
        if key.startswith(again.TASK)
    }
    return again.command(
        "eval",
        run.name,
        {**of_config, "name": run.told("task")},
        run.evaluation.made_from.overrides or [],
        EPISODES=run.evaluation.episodes,
    )


def _revision(versions: Versions) -> str:
    if not versions.git:
        return "-"
    return f"{versions.git[:HASH_DIGITS]}{'*' if versions.git_dirty else ''}"


def _versions(run: EvaluatedRun) -> Versions:
    """At the evaluation."""
    found = None if run.made_from is None else run.made_from.versions
    return Versions() if found is None else found


def _packages(run: EvaluatedRun) -> Mapping[str, str | None]:
    return _versions(run).packages or {}


def _once(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    """Runs with the same versions in one line."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, *told in lines:
        names.setdefault(tuple(told), []).append(name)
    return [[", ".join(of), *told] for told, of in names.items()]


def missing(rows: Sequence[RunGroup]) -> Section | None:
    """What could not be read, and actors that never learned; None if nothing is missing."""
    lines = [f"{run.name}: {line}" for row in rows for run in row.runs for line in run.missing]
    lines += never_learned(rows)
    if not lines:
        return None
    return Section(
        "missing",
        "What is missing",
        "These are not there, or not as they should be:",
        absent=lines,
        told=True,
    )


def _or_dash(value: Any) -> str:
    return "-" if value is None else str(value)
