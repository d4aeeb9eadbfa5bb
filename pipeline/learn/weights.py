"""The settings of a term's weight."""

from __future__ import annotations

from typing import Literal

from pydantic.dataclasses import dataclass as settings

from losses import Schedule, make_schedule
from losses.schedules import schedule_kind, setting_names
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

    def schedule(self, updates: int, key: str = "loss.bc_weight") -> Schedule:
        """The schedule; one that lasts moves over ``updates`` unless it has a duration.

        Args:
            updates: Of the actor in the whole run.
            key: Of these settings, for messages.

        Raises:
            ValueError: A value is missing, or is none that the kind reads, or they contradict.
        """
        given = {key: value for key, value in plain(self).items() if value is not None}
        options = {name: value for name, value in given.items() if name != "kind"}
        reads = setting_names(self.kind)
        for name, value in options.items():
            if name not in reads:
                raise ValueError(
                    f"{key}.{name}={value} is not read by {key}.kind={self.kind}, which has "
                    f"{', '.join(reads)}: leave it out ({key}.{name}=null) or name another kind"
                )
        if self.kind in LASTING:
            options.setdefault("duration", max(updates, 1))
        try:
            return make_schedule(self.kind, **options)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from error
