"""The settings of a term's weight."""

from __future__ import annotations

from typing import Literal

from pydantic.dataclasses import dataclass as settings

from losses import Schedule, make_schedule
from losses.schedules import schedule_kind
from pipeline.settings import STRICT, Count, Rate, Share, plain

LASTING = ("linear", "cosine")
"""Schedules that take the whole run unless they have a duration of their own."""


@settings(frozen=True, kw_only=True, config=STRICT)
class WeightSettings:
    """Weight of the imitation term as a function of the number n of updates (III-C, III-D).

    One class with the keys of all kinds, not one class for each: Hydra accepts the keys of the
    defaults only, and saved runs hold every key, with null for those of other kinds.
    """

    kind: Literal["constant", "exponential", "linear", "cosine", "piecewise"] = "constant"
    init: Rate | None = 0.0  # lambda, or lambda_0; None for piecewise
    decay: Share | None = None  # exponential: alpha in lambda_0 * alpha**n
    final: Rate | None = None  # linear, cosine: value after `duration`
    duration: Count | None = None  # linear, cosine: updates; None = all of the run's
    milestones: tuple[Count, ...] | None = None  # piecewise: updates
    values: tuple[Rate, ...] | None = None  # piecewise: one more than milestones

    @classmethod
    def of(cls, schedule: Schedule | float) -> WeightSettings:
        """The settings of a schedule of `losses.schedules`, or of a constant.

        Raises:
            ValueError: It is another callable, which a run directory could not hold.
        """
        if isinstance(schedule, int | float):
            return cls(init=float(schedule))
        return cls(**({"init": None} | vars(schedule) | {"kind": schedule_kind(schedule)}))

    def schedule(self, updates: int) -> Schedule:
        """The schedule; one that lasts moves over ``updates`` unless it has a duration."""
        options = {key: value for key, value in plain(self).items() if value is not None}
        if self.kind in LASTING:
            options.setdefault("duration", max(updates, 1))
        return make_schedule(**options)
