"""Medians, spreads and rounding."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass


def rounded(value: float, digits: int = 4) -> float:
    """``value`` to ``digits`` significant digits; a spread of 10 % does not carry more.

    Raises:
        ValueError: If it is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"a measurement must be finite, got {value}")
    return float(f"{value:.{digits}g}")


@dataclass(frozen=True)
class Spread:
    """The middle of several rounds and how far they lie apart."""

    median: float
    low: float
    """First quartile."""
    high: float
    """Third quartile."""
    rounds: int

    def as_json(self, unit: str) -> dict[str, float | int | str]:
        """Plain values; the unit is named with them."""
        return {
            "median": rounded(self.median),
            "quartile_1": rounded(self.low),
            "quartile_3": rounded(self.high),
            "rounds": self.rounds,
            "unit": unit,
        }


def spread(samples: Sequence[float], scale: float = 1.0) -> Spread:
    """Median and quartiles of ``samples * scale``.

    Quartiles interpolate between the samples (R's type 7), so those of one sample are itself.

    Raises:
        ValueError: If there are no samples.
    """
    if not samples:
        raise ValueError("a spread needs at least one sample")
    scaled = [sample * scale for sample in samples]
    if len(scaled) == 1:
        return Spread(scaled[0], scaled[0], scaled[0], 1)
    low, _, high = statistics.quantiles(scaled, n=4, method="inclusive")
    return Spread(statistics.median(scaled), low, high, len(scaled))
