"""What a run says of itself on the way, in lines for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def duration(seconds: float) -> str:
    """``12 s``, ``1 min 15 s`` or ``2 h 3 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def outcome(figures: Mapping[str, Any]) -> str:
    """Success and return of an evaluation; the return alone where a task tells no success.

    Args:
        figures: of :class:`pipeline.act.metrics.EpisodeMetrics`; without any, nothing is said.
    """
    if "return_mean" not in figures:
        return ""
    success = figures.get("success_once")
    told = "" if success is None else f"success {100 * success:.0f} %, "
    return f"{told}return {figures['return_mean']:.4g}"


def evaluated(
    done: int, total: int, unit: str, seconds: float | None, figures: Mapping[str, Any]
) -> str:
    """The line after an evaluation.

    Args:
        done: frames or updates so far.
        total: of the whole run.
        unit: what is counted.
        seconds: of the run so far; None is not told.
        figures: as in :func:`outcome`.
    """
    lasted = "" if seconds is None else f", {duration(seconds)}"
    return f"{done:,} of {total:,} {unit}{lasted}: {outcome(figures)}"
