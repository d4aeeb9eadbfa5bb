"""How an update's time and a process's memory grow along one size at a time.

Environment steps against the number of doors are in ``env_steps_per_s``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks import ours
from benchmarks.effort import Effort
from benchmarks.statistics import rounded, spread
from benchmarks.worker import Entry, race

BASE = {"width": 256, "batch": 256, "critics": 2, "demo_rows": 5_000, "replay_rows": 100_000}
AXES: dict[str, Sequence[int]] = {
    "batch": (128, 256, 512, 1024),
    "width": (128, 256, 512, 1024),
    "critics": (2, 5, 10),
    "demo_rows": (5_000, 50_000, 500_000),
    "replay_rows": (10_000, 100_000, 1_000_000),
}


def entry(effort: Effort, axis: str, value: int) -> Entry:
    """The base size with one of its values changed."""
    size = {**BASE, axis: value}
    overrides = [
        *ours.paper_size("bc_sac", size["width"], size["batch"]),
        f"critic.num_critics={size['critics']}",
    ]
    return Entry(
        str(value),
        "benchmarks.ours:make_updater",
        {
            "overrides": overrides,
            "precision": "auto",
            "replay_rows": size["replay_rows"],
            "demo_rows": size["demo_rows"],
            "updates": 2,
        },
        effort.threads,
    )


def run(effort: Effort) -> dict[str, Any]:
    """Key ``scaling``: for each axis ms per update and peak MiB at each value."""
    result = effort.as_json(base=BASE, precision="auto", variant="bc_sac")
    for axis, values in AXES.items():
        chosen = values[:2] if effort.quick else values
        entries = [entry(effort, axis, value) for value in chosen]
        timings = race(entries, rounds=max(2, effort.rounds // 2), block_s=effort.block_s / 2)
        result[axis] = {
            name: {
                "ms_per_update": rounded(spread(timing.seconds_per_unit, 1e3).median),
                "peak_mib": rounded(timing.peak_mib),
            }
            for name, timing in timings.items()
        }
    return {"scaling": result}
