"""Sections of the report that come from single episodes: maps, failures, times, progress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import Task
from envs.intervals import wilson
from pipeline.files import again
from pipeline.report.charts import (
    Curve,
    bars,
    binned_panel,
    chart,
    curves_panel,
    in_order,
    panels,
    start_map,
)
from pipeline.report.page import Section, Table, told_once
from pipeline.results.curves import Band
from pipeline.results.evaluation_files import NO_STAGE, STAGE, START
from pipeline.results.runs import RunGroup

SUCCESS = "success_once"
MOST_AXES = 6
"""Of a start that is a place; longer ones are states."""
BINS = 5
NO_PLACES = "its task says no places where episodes begin, or no success"


def stages(rows: Sequence[RunGroup]) -> Section:
    """How far episodes get: the last landmark that each ever reached."""
    shares = {row.name: found for row in rows if (found := _furthest(row))}
    labels = list({label: None for found in shares.values() for label in found})
    parts = {label: [found.get(label, 0.0) for found in shares.values()] for label in labels}
    lines = [
        [name, *(f"{100 * found.get(label, 0.0):.1f} %" for label in labels)]
        for name, found in shares.items()
    ]
    return Section(
        "stages",
        "Where episodes stop",
        "Share of episodes by the last of the task's landmarks that they ever reached; "
        f"'{NO_STAGE}' reached none.",
        tables=[Table(["row", *labels], lines)] if lines else [],
        charts=[
            chart(
                "the last landmark reached",
                bars(parts, list(shares), "share of episodes", in_order(len(labels)), share=True),
                wide=True,
            )
        ]
        if shares
        else [],
        absent=told_once(
            {row.name: "evaluations without stages" for row in rows if row.name not in shares},
            [row.name for row in rows],
            "rows",
        ),
    )


def to_get_them() -> str:
    """Why there is nothing to show of a row's episodes."""
    return f"no table of the episodes; make it with: {again.command('eval', '...', {})}"


def _furthest(row: RunGroup) -> dict[str, float]:
    """Shares by stage, in the order of the task; from the summaries where tables are missing."""
    known = [evaluation.stages or {} for evaluation in row.evaluations]
    order = next((list(found) for found in known if found), [])
    if not order:
        return {}
    told = [label for run in row.runs for label in run.episodes.get(STAGE, ())]
    if told:
        counted = Counter(told)
        return {label: counted[label] / len(told) for label in (NO_STAGE, *order)}
    passed = [
        (1.0, *(float(found[label]) for label in order), 0.0)
        for found in known
        if all(label in found for label in order)
    ]
    if not passed:
        return {}
    # Of landmarks passed in turn: who got to one and not to the next.
    stops = np.mean([[max(a - b, 0.0) for a, b in pairwise(run)] for run in passed], axis=0)
    return dict(zip((NO_STAGE, *order), stops.tolist(), strict=True))


def times(rows: Sequence[RunGroup]) -> Section:
    """Share of episodes that have succeeded by each control step."""
    found = []
    for place, row in enumerate(rows):
        tables = [run.episodes for run in row.runs if "steps_to_success" in run.episodes]
        if tables:
            reached = [step for table in tables for step in table["steps_to_success"]]
            horizon = int(max(max(table["steps"]) for table in tables))
            steps = np.arange(horizon + 1, dtype=np.float64)
            known = np.sort([step for step in reached if step is not None])
            share = np.searchsorted(known, steps, side="right") / len(reached)
            found.append(Curve(row.name, Band(steps, share, share, share), place))
    told = {curve.name for curve in found}
    return Section(
        "times",
        "Time to success",
        "Share of all episodes that have succeeded by a control step; where a line ends is the "
        "share that ever does.",
        charts=[
            chart("success by step", curves_panel(group, "control step", "share", share=True))
            for group in panels(found, lambda curve: curve.place)
        ],
        absent=told_once(
            {row.name: to_get_them() for row in rows if row.name not in told},
            [row.name for row in rows],
            "rows",
        ),
    )


def progress(rows: Sequence[RunGroup], task: Task | None) -> Section | None:
    """Median progress over an episode, with the middle four fifths of the episodes."""
    found = []
    for place, row in enumerate(rows):
        tables = [run.progress for run in row.runs if run.progress]
        if tables:
            steps = min(len(table["step"]) for table in tables)
            mean = {
                q: np.mean([t[q][:steps] for t in tables], axis=0) for q in ("q10", "q50", "q90")
            }
            x = np.asarray(tables[0]["step"][:steps], dtype=np.float64)
            found.append(Curve(row.name, Band(x, mean["q50"], mean["q10"], mean["q90"]), place))
    if not found:
        return None
    unit = f" ({task.progress_unit})" if task is not None and task.progress_unit else ""
    return Section(
        "progress",
        "Progress within an episode",
        "Line: the median episode; band: 10 to 90 % of the episodes that still run at that step; "
        "means over seeds.",
        charts=[
            chart(f"progress{unit}", curves_panel(group, "control step", f"progress{unit}"))
            for group in panels(found, lambda curve: curve.place)
        ],
    )


def maps(rows: Sequence[RunGroup], task: Task | None) -> Section:
    """Success over where episodes begin."""
    mapped = {row.name: found for row in rows if (found := _starts(row)) is not None}
    lacking = {
        row.name: NO_PLACES if any(run.episodes for run in row.runs) else to_get_them()
        for row in rows
        if row.name not in mapped
    }
    charts, lines = [], []
    order = {row.name: place for place, row in enumerate(rows)}
    axes = list({axis: None for places, _ in mapped.values() for axis in places})
    units = _units(task)
    binned = {axis: _binned(mapped, axis) for axis in axes}
    for axis, bins in binned.items():
        charts += [
            chart(f"success over {axis}", binned_panel(dict(group), order, f"{axis}{units}"))
            for group in panels(list(bins.items()), lambda item: order[item[0]])
        ]
        lines += [
            [name, axis, *(f"{100 * share:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
                           for share, low, high in zip(shares, lows, highs, strict=True))]
            for name, (_, shares, lows, highs) in bins.items()
        ]  # fmt: skip
    widest = sorted(axes, key=lambda axis: -_spread(binned[axis]))[:2]
    if len(widest) == 2:
        x, y = sorted(widest, key=axes.index)
        for name, (places, success) in mapped.items():
            labels = (f"{x}{units}", f"{y}{units}")
            figure = start_map(places[x], places[y], success.mean(axis=0), labels)
            charts.append(chart(f"{name}: success by start", figure))
    headers = ["row", "axis", *(f"fifth {i + 1}" for i in range(BINS))]
    return Section(
        "maps",
        "Success over starts",
        "Success in five equally large parts of the starts along each axis, from the lowest to the "
        "highest, with Wilson's 95 % intervals over episodes and seeds. The maps show the two axes "
        "along which success varies most; a point is a start, its colour the share of the seeds "
        "that succeed from there.",
        tables=[Table(headers, lines)] if lines else [],
        charts=charts,
        absent=told_once(lacking, [row.name for row in rows], "rows"),
    )


Places = Mapping[str, NDArray[np.float64]]


def _starts(row: RunGroup) -> tuple[Places, NDArray[np.bool_]] | None:
    """Starts [E] by axis, and whether each run succeeds from each, [S, E]."""
    tables = [run.episodes for run in row.runs if SUCCESS in run.episodes]
    if not tables:
        return None
    names = [name for name in tables[0] if name.startswith(START)]
    if not 2 <= len(names) <= MOST_AXES:
        return None
    # The same list of starts, as far as the shortest evaluation goes.
    count = min(len(table[SUCCESS]) for table in tables)
    tables = [t for t in tables if all(t[n][:count] == tables[0][n][:count] for n in names)]
    places = {name.removeprefix(START): np.array(tables[0][name][:count]) for name in names}
    moving = {name: values for name, values in places.items() if np.ptp(values) > 0}
    success = np.array([table[SUCCESS][:count] for table in tables], dtype=bool)
    return (moving, success) if moving else None


Bins = tuple[list[float], list[float], list[float], list[float]]


def _binned(mapped: Mapping[str, tuple[Places, Any]], axis: str) -> dict[str, Bins]:
    found: dict[str, Bins] = {}
    for name, (places, success) in mapped.items():
        if axis not in places:
            continue
        parts = [p for p in np.array_split(np.argsort(places[axis], kind="stable"), BINS) if p.size]
        intervals = [wilson(success[:, part]) for part in parts]
        found[name] = (
            [float(places[axis][part].mean()) for part in parts],
            [float(success[:, part].mean()) for part in parts],
            [low for low, _ in intervals],
            [high for _, high in intervals],
        )
    return found


def _spread(bins: Mapping[str, Bins]) -> float:
    return max((max(shares) - min(shares) for _, shares, _, _ in bins.values()), default=0.0)


def _units(task: Task | None) -> str:
    if task is None or task.demos is None:
        return ""
    units = {start.unit for start in task.demos.start if start.axes}
    return f" ({units.pop()})" if len(units) == 1 and units != {""} else ""
