"""Sections of the report that come from training: curves, diagnostics, wall time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from envs.reference import Reference
from pipeline.report.charts import Curve, bars, chart, curves_panel, in_order, panels
from pipeline.report.page import Chart, Section, Table, told_once
from pipeline.results.curves import (
    AXES,
    Axis,
    Band,
    column,
    curves_over,
    is_offline,
    last_of,
    tells,
)
from pipeline.results.curves import DIAGNOSTICS as PANELS
from pipeline.results.run_tables import RETURN, reference_row
from pipeline.results.runs import RunGroup
from pipeline.watch.alarm import FADED, FALL, NATS, PREFERENCE

SUCCESS = "success_once"
UPDATES = "actor_updates"
MARGIN = 0.05
"""Of an axis, beyond what is drawn."""
SHORT_S = 120.0
"""Rows whose longest took less are timed in seconds, others in minutes."""


@dataclass(frozen=True)
class Diagnostic:
    """A number that a living run is judged by.

    Attributes:
        label: what it is, with its unit.
        healthy: its range in words.
        value: of a row, from the last rows of its curves; None if they do not tell it.
        well: whether a value is in its range.
    """

    label: str
    healthy: str
    value: Callable[[RunGroup], float | None]
    well: Callable[[float], bool]


def _difference(more: str, less: str, per: str | None = None) -> Callable[..., float | None]:
    def value(row: RunGroup) -> float | None:
        a, b = last_of(row, more), last_of(row, less)
        scale = 1.0 if per is None else abs(last_of(row, per) or 0.0)
        return None if a is None or b is None or not scale else (a - b) / scale

    return value


def _imitation_share(row: RunGroup) -> float | None:
    weight, bc, rl = (last_of(row, k) for k in ("bc_weight", "grad_norm_bc", "grad_norm_rl"))
    return None if weight is None or bc is None or not rl else weight * bc / rl


def _memorised(row: RunGroup) -> float | None:
    """In nats; a mean squared error is of another unit, and its bound is not known."""
    if row.told("loss.imitation") == "mse":
        return None
    return _difference("bc_nll_held_out", "bc_nll_train")(row)


def _alarms(row: RunGroup) -> float | None:
    return (
        float(sum(len(run.alarms) for run in row.runs)) if any(r.curve for r in row.runs) else None
    )


DIAGNOSTICS = (
    Diagnostic("alarms of unlearning, all runs", "0", _alarms, lambda v: v == 0),
    Diagnostic(
        "overestimation: (q_policy_actions - q_demo_actions) / |q_demo_actions|",
        f"at most {PREFERENCE:g}",
        _difference("q_policy_actions", "q_demo_actions", "q_demo_actions"),
        lambda v: v <= PREFERENCE,
    ),
    Diagnostic(
        "memorised demonstrations: bc_nll_held_out - bc_nll_train, nats",
        f"at most {NATS:g}; not judged with loss.imitation=mse",
        _memorised,
        lambda v: v <= NATS,
    ),
    Diagnostic(
        "imitation gradient over RL gradient, with its weight",
        f"at least {FADED:g} while imitation shall hold the policy",
        _imitation_share,
        lambda v: v >= FADED,
    ),
    Diagnostic(
        "the evaluated action alone fails: train_success - success_once",
        f"below {FALL:g}",
        _difference("train_success", SUCCESS),
        lambda v: v < FALL,
    ),
)


def curves(rows: Sequence[RunGroup], reference: Reference | None) -> Section:
    """Success and return over frames, simulator steps and wall time."""
    charts: list[Chart] = []
    for key, label, share in (
        (SUCCESS, "share that succeeds", True),
        ("success_at_end", "share successful at the end", True),
        (RETURN, "return", False),
    ):
        charts += _panels(rows, key, label, share=share, reference=reference)
    lacking = {r.name: "no learning curve" for r in rows if not any(run.curve for run in r.runs)}
    for axis in AXES:
        reason = f"no curve over {axis.label}, which not all runs of the row told"
        lacking |= {
            row.name: reason for row in rows if row.name not in lacking and not tells(row, axis)
        }
    return Section(
        "curves",
        "Learning curves",
        "Evaluations while training, of fewer episodes than the final one. Line: interquartile "
        "mean over seeds; band: its 95 % interval (bootstrap, from three seeds on). Level: what "
        "was learned from demonstrations alone, in the end. Dashed: the published number of the "
        "row, where there is one. Simulator steps are frames, and what demonstrations and "
        "rollouts beside them took; evaluations are in none of the axes but wall time.",
        charts=charts,
        axes=_choice(rows),
        absent=told_once(lacking, [row.name for row in rows], "rows"),
    )


def _panels(
    rows: Sequence[RunGroup],
    key: str,
    label: str,
    *,
    share: bool = False,
    reference: Reference | None = None,
) -> list[Chart]:
    """Panels of a few rows each, all with one vertical axis, whatever they are read over."""
    found = {
        axis.key: [
            Curve(rows[place].name, band, place, published(rows[place], key, reference))
            for place, band in curves_over(rows, key, axis).items()
        ]
        for axis in AXES
    }
    first = AXES[0]
    bands = [curve.band for curves in found.values() for curve in curves]
    span = None if share or not bands else _span(bands)
    groups = panels(found[first.key], lambda curve: curve.place)

    def figure(group: Sequence[Curve], axis: Axis) -> go.Figure:
        places = {curve.place for curve in group}
        shown = [curve for curve in found[axis.key] if curve.place in places]
        return curves_panel(shown, axis.label, label, share=share, span=span)

    return [
        chart(
            f"{label} ({i + 1} of {len(groups)})" if len(groups) > 1 else label,
            figure(group, first),
            over={axis.key: figure(group, axis) for axis in AXES[1:] if axis.key in _choice(rows)},
        )
        for i, group in enumerate(groups)
    ]


def _choice(rows: Sequence[RunGroup]) -> dict[str, str]:
    """Labels of what curves can be read over, by key; none if only one is told."""
    told = {axis.key: axis.label for axis in AXES if any(tells(row, axis) for row in rows)}
    return told if len(told) > 1 else {}


def published(row: RunGroup, key: str, reference: Reference | None) -> float | None:
    """The published number of a row for a figure of ours; None if there is none."""
    variant = row.told("variant")
    if reference is None or variant is None:
        return None
    theirs = reference_row(reference, variant, row.told("bc_weight")) or {}
    return theirs.get(reference.success if key == SUCCESS else key)


def diagnostics(rows: Sequence[RunGroup]) -> Section:
    """What explains a success or a failure, with the ranges that the alarm goes by."""
    lines = []
    for diagnostic in DIAGNOSTICS:
        cells = []
        for row in rows:
            value = diagnostic.value(row)
            mark = "" if value is None or diagnostic.well(value) else " (!)"
            cells.append("-" if value is None else f"{value:.3g}{mark}")
        if any(cell != "-" for cell in cells):
            lines.append([diagnostic.label, diagnostic.healthy, *cells])
    charts = []
    for panel in PANELS:
        for key in panel.keys:
            title = panel.title if len(panel.keys) == 1 else f"{panel.title}: {key}"
            charts += _panels(rows, key, title)
    headers = ["at the last evaluation", "healthy", *(row.name for row in rows)]
    return Section(
        "diagnostics",
        "Diagnostics",
        "Means over seeds. (!) is out of its range, which is where a cause is suspected when a "
        "policy unlearns; on a policy that succeeds it is no fault.",
        tables=[Table(headers, lines)] if lines else [],
        charts=charts,
        folded=True,
        axes=_choice(rows),
        absent=[] if lines else ["no run has a learning curve with diagnostics"],
    )


def never_learned(rows: Sequence[RunGroup]) -> list[str]:
    """Rows that took frames and whose actors got no update, a line each; what they show is no RL.

    By the last row of the learning curve that counts them; none of rows that count none.
    """
    found = []
    for row in rows:
        updates = [value for run in row.runs for value in column(run, UPDATES)[1][-1:]]
        if updates and not any(updates) and not is_offline(row):
            found.append(
                f"{row.name}: actor updates: 0, so this row is the policy that it began with, its "
                "clone where it has one; train for longer or lower optim.actor_delay"
            )
    return found


def wall_time(rows: Sequence[RunGroup]) -> Section:
    """Where the time went."""
    timed = {row.name: [run.seconds for run in row.runs if run.seconds] for row in rows}
    known = {name: runs for name, runs in timed.items() if runs}
    names = {part: None for runs in known.values() for run in runs for part in run}
    seconds = {
        part: [float(np.mean([run.get(part, 0.0) for run in runs])) for runs in known.values()]
        for part in names
    }
    longest = max((sum(row) for row in zip(*seconds.values(), strict=True)), default=0.0)
    unit, length = ("min", 60.0) if longest >= SHORT_S else ("s", 1.0)
    lengths = {part: [value / length for value in of] for part, of in seconds.items()}
    parts = dict(sorted(lengths.items(), key=lambda part: -sum(part[1])))
    lines = [
        [name, f"{sum(part[i] for part in parts.values()):.1f}",
         *(f"{part[i]:.1f}" for part in parts.values())]
        for i, name in enumerate(known)
    ]  # fmt: skip
    return Section(
        "time",
        "Wall time",
        f"Mean over the runs of a row, {unit}. Runs that shared a machine slowed one another down.",
        tables=[Table(["row", "all", *parts], lines)] if lines else [],
        charts=[
            chart("parts of a run", bars(parts, list(known), unit, in_order(len(parts))), wide=True)
        ]
        if known
        else [],
        absent=told_once(
            {name: "no time_use.json" for name in timed if name not in known}, list(timed), "rows"
        ),
    )


def _span(bands: Sequence[Band]) -> tuple[float, float]:
    low = min(float(band.low.min()) for band in bands)
    high = max(float(band.high.max()) for band in bands)
    margin = MARGIN * (high - low or 1.0)
    return low - margin, high + margin
