"""How much of what an evaluation begins with the demonstrations begin with too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Coverage:
    """One number that says where episodes begin.

    Attributes:
        name: of the vector and its entry: ``door_position[0]``.
        low: smallest value among the evaluation's starts.
        high: largest.
        demo_low: smallest among the demonstrations.
        demo_high: largest.
        share: of the evaluation's starts between the demonstrations' smallest and largest value.
    """

    name: str
    low: float
    high: float
    demo_low: float
    demo_high: float
    share: float


@dataclass(frozen=True)
class StartCoverage:
    """Coverage of all numbers that say where episodes begin.

    Attributes:
        entries: in the order of the vectors; those that the evaluation never varies are left out.
        share: of the evaluation's starts that lie within the demonstrations in every entry. At most
            the smallest of the entries' shares.
    """

    entries: tuple[Coverage, ...]
    share: float


def start_coverage(
    starts: Mapping[str, NDArray[Any]], demos: Mapping[str, NDArray[Any]]
) -> StartCoverage:
    """Compare where evaluations begin with where demonstrations do.

    A policy is asked to extrapolate where a share is below 1: nothing was shown there. Within the
    smallest and the largest value there may still be holes.

    Args:
        starts: vectors [E, D] of the evaluation's starts by name.
        demos: vectors [M, D] of the demonstrations' starts, under the same names; M > 0.
    """
    entries: list[Coverage] = []
    inside: list[NDArray[np.bool_]] = []
    for name, values in starts.items():
        shown = np.asarray(demos[name], dtype=np.float64)
        for i, column in enumerate(np.asarray(values, dtype=np.float64).T):
            low, high = float(shown[:, i].min()), float(shown[:, i].max())
            if column.min() == column.max():
                continue
            inside.append((column >= low) & (column <= high))
            share = float(inside[-1].mean())
            span = (float(column.min()), float(column.max()))
            entries.append(Coverage(f"{name}[{i}]", *span, low, high, share))
    share = float(np.logical_and.reduce(inside).mean()) if inside else 1.0
    return StartCoverage(tuple(entries), share)


def least_covered(coverage: StartCoverage, count: int) -> Sequence[Coverage]:
    """The ``count`` entries of the smallest shares, in their own order."""
    ranked = np.argsort([entry.share for entry in coverage.entries], kind="stable")[:count]
    return [coverage.entries[i] for i in sorted(ranked)]
