"""Sections of the report that say how a policy goes about its task, and what it withstands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from pipeline.report.charts import bars, chart, heat_map, in_order
from pipeline.report.page import Section, Table
from pipeline.results.evaluation import Strategies
from pipeline.results.runs import RunGroup

BESIDE: Final = ("progress at last contact", "travel untouched, %")
BESIDE_MEANING: Final = (
    "Progress at the last contact: median [10, 90 %] over episodes; travel untouched: mean over "
    "the episodes that moved something."
)
TRIED: Final = "At other thresholds, one at a time"


def strategies(rows: Sequence[RunGroup]) -> Section | None:
    """How the episodes were done; None if no evaluation tells."""
    found = {row.name: told for row in rows if (told := _told(row))}
    if not found:
        return None
    words: Mapping[str, str] = next(iter(found.values()))[0].words
    shares = {name: _mean_shares([of.shares for of in told]) for name, told in found.items()}
    parts = {key: [of.get(key, 0.0) for of in shares.values()] for key in words}
    touched = any(of.progress_at_last_contact for told in found.values() for of in told)
    lines = [
        [
            name,
            *(_percent(of.get(key, 0.0)) for key in words),
            *(_beside(found[name]) if touched else ()),
        ]
        for name, of in shares.items()
    ]
    meaning = "; ".join(f"'{key}': {text}" for key, text in words.items())
    at = found[next(iter(found))][0].thresholds
    thresholds = ", ".join(f"{key} {value:g}" for key, value in at.items())
    tried = [line for name, told in found.items() for line in _sensitivity(name, told, words)]
    return Section(
        "strategies",
        "Strategies",
        f"Share of episodes by how they were done, means over seeds. {meaning}."
        f"{f' Thresholds: {thresholds} (docs/metrics.md).' if at else ''}",
        tables=[
            Table(
                ["row", *words, *(BESIDE if touched else ())],
                lines,
                caption=BESIDE_MEANING if touched else "",
            ),
            *_held(found, words),
            *([Table(["row", "threshold", *words], tried, TRIED, folded=True)] if tried else []),
        ],
        charts=[
            chart(
                "strategies",
                bars(parts, list(shares), "share of episodes", in_order(len(parts)), share=True),
                wide=True,
            )
        ],
    )


def robustness(rows: Sequence[RunGroup]) -> Section | None:
    """What each run withstands; None if none was disturbed."""
    runs = [run for row in rows for run in row.runs if run.robustness is not None]
    if not runs:
        return None
    tables, charts = [], []
    for run in runs:
        found = run.robustness
        assert found is not None
        whole = f"{found.episodes} episodes a setting, undisturbed {found.undisturbed.text}"
        tables.append(Table(found.headers, found.rows(), f"{run.name}: {whole}"))
        cells = {
            ladder.what: [(m.setting, m.success) for m in ladder.settings]
            for ladder in found.ladders
        }
        charts.append(chart(f"{run.name}: success under disturbance", heat_map(cells), wide=True))
    return Section(
        "robustness",
        "Robustness",
        "Success in % under one disturbance at a time, from the weakest to the strongest, with "
        "Wilson's 95 % intervals. The last column is the weakest setting below the bar.",
        tables=tables,
        charts=charts,
    )


def _told(row: RunGroup) -> list[Strategies]:
    return [told for one in row.evaluations if (told := one.strategies) is not None]


def _mean_shares(shares: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {key: float(np.mean([of.get(key, 0.0) for of in shares])) for key in shares[0]}


def _beside(told: Sequence[Strategies]) -> list[str]:
    last = [found for of in told if (found := of.progress_at_last_contact)]
    free = [mean for of in told if (mean := of.travel_untouched_mean) is not None]
    if not last:
        return ["-", "-"]
    low, middle, high = np.mean(last, axis=0)
    return [
        f"{middle:.3g} [{low:.3g}, {high:.3g}]",
        f"{100 * np.mean(free):.1f}" if free else "-",
    ]


def _held(found: Mapping[str, Sequence[Strategies]], words: Mapping[str, str]) -> list[Table]:
    """How successes were held; nothing where no evaluation says so, as of before it was asked."""
    lines = []
    for name, told in found.items():
        kept = [of.kept_at_end for of in told if of.kept_at_end is not None]
        lost = [of.lost_at_end for of in told if of.lost_at_end is not None]
        if kept or lost:
            by_way = ([share for of in kept if (share := of.get(key)) is not None] for key in words)
            lines.append([name, *map(_mean_percent, by_way), _mean_percent(lost)])
    caption = (
        "By class, % of its episodes that are still a success after their last step, means over "
        "the seeds that have such episodes. Lost: % of all episodes that were a success once and "
        "are none after their last step."
    )
    head = ["row", *words, "lost, of all"]
    return [Table(head, lines, "How a success was held", caption)] if lines else []


def _mean_percent(shares: Sequence[float]) -> str:
    return _percent(float(np.mean(shares))) if shares else "-"


def _sensitivity(
    name: str, told: Sequence[Strategies], words: Mapping[str, str]
) -> list[list[str]]:
    lines = []
    for threshold, values in told[0].sensitivity.items():
        in_use = f"{told[0].thresholds.get(threshold, math.nan):g}"
        for value in values:
            if value == in_use:  # stands in the table above
                continue
            tried = [of.sensitivity.get(threshold, {}) for of in told]
            shares = _mean_shares([of[value] for of in tried if value in of])
            line = [_percent(shares.get(key, 0.0)) for key in words]
            lines.append([name, f"{threshold} {value}", *line])
    return lines


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"
