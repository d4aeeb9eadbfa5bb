"""The settings of a term's weight, and the schedule that they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields
from difflib import get_close_matches
from typing import Annotated, Any

from pydantic import AfterValidator, model_validator
from pydantic.dataclasses import dataclass as settings
from pydantic_core import PydanticCustomError

from envs.user_files import split_file
from losses import SCHEDULES, Schedule, make_schedule
from losses.schedules import schedule_kind, setting_names
from pipeline.learn.own_schedules import own_schedule
from pipeline.own_parts import is_setting
from pipeline.settings import STRICT, Count, Rate, Share, plain


def _is_own(kind: str) -> bool:
    """Whether it is ``path.py:NAME``."""
    return bool((split_file(kind) or ("", ""))[1])


def _known(kind: str) -> str:
    if kind not in SCHEDULES and not _is_own(kind):
        alike = get_close_matches(kind, SCHEDULES, n=1)
        told = {
            "all": ", ".join(map(repr, SCHEDULES)),
            "meant": f" (did you mean {alike[0]}?)" if alike else "",
        }
        message = "Input should be {all} or path.py:NAME of your own{meant}"
        raise PydanticCustomError("schedule_kind", message, told)
    return kind


def _further(values: dict[str, Any]) -> dict[str, Any]:
    if any(name in _keys() for name in values):
        raise PydanticCustomError("kwargs", "Input should be keys that do not stand beside kwargs")
    if not all(value is None or is_setting(value) for value in values.values()):
        raise PydanticCustomError(
            "kwargs", "Input should be finite numbers, strings, true, false, null or lists of these"
        )
    return values


ScheduleKind = Annotated[str, AfterValidator(_known)]
FurtherSettings = Annotated[dict[str, Any], AfterValidator(_further)]


@settings(frozen=True, kw_only=True, config=STRICT)
class WeightSettings:
    """Weight of the imitation term as a function of the number n of updates (III-C, III-D).

    One class with the keys of all kinds, not one class for each: Hydra accepts the keys of the
    defaults only, and saved runs hold every key, with null for those of other kinds. A kind is
    made with all that are not null. Its settings of other names, of a user's own schedule or of a
    new one of ``losses.schedules``, may stand beside these, and are kept in ``kwargs``.
    """

    kind: ScheduleKind = "constant"
    # lambda, or lambda_0; None for piecewise and for a schedule of your own without it
    init: Rate | None = 0.0
    decay: Share | None = None  # exponential: alpha in lambda_0 * alpha**n
    final: Rate | None = None  # linear, cosine: value after `duration`
    duration: Count | None = None  # linear, cosine: updates; None = all of the run's
    milestones: tuple[Count, ...] | None = None  # piecewise: updates
    values: tuple[Rate, ...] | None = None  # piecewise: one more than milestones
    kwargs: FurtherSettings = field(default_factory=dict)  # further ones of a schedule of your own

    @model_validator(mode="before")
    @classmethod
    def _gathered(cls, given: Any) -> Any:
        """Settings that have no key here, among ``kwargs``; a kind without ``init`` gets none."""
        if not isinstance(given, Mapping):
            return given
        kind = given.get("kind", "constant")
        own = isinstance(kind, str) and _is_own(kind)
        reads = setting_names(kind) if isinstance(kind, str) and kind in SCHEDULES else ()
        further = {
            name: given[name] for name in given if name not in _keys() and (own or name in reads)
        }
        kept = {name: value for name, value in given.items() if name not in further}
        if further and isinstance(beside := kept.get("kwargs", {}), Mapping):
            kept["kwargs"] = {**beside, **further}
        if own or (reads and "init" not in reads):
            kept.setdefault("init", None)
        return kept

    @classmethod
    def of(cls, schedule: Schedule | float) -> WeightSettings:
        """The settings of a schedule of `losses.schedules`, or of a constant.

        Raises:
            ValueError: It is another callable, which a run directory could not hold.
        """
        if isinstance(schedule, int | float):
            return cls(init=float(schedule))
        given = {"init": None} | vars(schedule)
        further = {name: given.pop(name) for name in set(given) - _keys()}
        return cls(kind=schedule_kind(schedule), kwargs=further, **given)

    @property
    def own_file(self) -> str | None:
        """``path.py:NAME`` of a user's own schedule; None for one of ``losses.schedules``."""
        return self.kind if _is_own(self.kind) else None

    @property
    def options(self) -> dict[str, Any]:
        """What the schedule is made with: all settings that are not null."""
        every = plain(self)
        every = every | every.pop("kwargs")
        return {k: value for k, value in every.items() if value is not None and k != "kind"}

    def schedule(self, updates: int, key: str = "loss.bc_weight") -> Schedule:
        """The schedule; one with a ``duration`` moves over ``updates`` unless that is given.

        One of a user's own file runs its code.

        Args:
            updates: Of the actor in the whole run.
            key: Of these settings, for messages.

        Raises:
            ValueError: A value is missing, or is none that the kind reads, or they contradict; or a
                user's own fails, or gives something else.
        """
        options = self.options
        if self.own_file is not None:
            return own_schedule(key, {"kind": self.own_file, **options}, updates)
        reads = setting_names(self.kind)
        for name, value in options.items():
            if name not in reads:
                unread = f"{key}.{name}" if name in _keys() else f"{key}.kwargs.{name}"
                raise ValueError(
                    f"{unread}={value} is not read by {key}.kind={self.kind}, which has "
                    f"{', '.join(reads)}: leave it out ({unread}=null) or name another kind"
                )
        if "duration" in reads:
            options.setdefault("duration", max(updates, 1))
        try:
            return make_schedule(self.kind, **options)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from error


def _keys() -> set[str]:
    return {one.name for one in fields(WeightSettings)}
