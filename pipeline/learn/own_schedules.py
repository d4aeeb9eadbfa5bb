"""A schedule of a weight that stands in a user's own file (``kind: path.py:NAME``)."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any

from envs.library.functions import load_function
from envs.one_line import kind_and_text
from losses import Schedule
from pipeline.own_parts import Entry, OwnParts


@dataclass(frozen=True)
class OwnSchedule:
    """A user's schedule, of which every weight is looked at.

    Attributes:
        weight: Gives the weight after a number of updates.
        parts: What refuses it.
        entry: Of the configuration, for messages.
    """

    weight: Callable[[int], Any]
    parts: OwnParts
    entry: Entry

    def __call__(self, updates: int) -> float:
        """The weight after ``updates``.

        Raises:
            ValueError: It fails, or gives no finite number >= 0.
        """
        try:
            found = self.weight(updates)
        # Whatever a user's function raises is told in one line.
        except Exception as error:
            raise self.parts.refused(
                self.entry, f"failed after {updates} updates ({kind_and_text(error)})"
            ) from error
        number = isinstance(found, Real) and not isinstance(found, bool)
        if not number or not math.isfinite(found) or found < 0:
            raise self.parts.refused(
                self.entry,
                f"gave {found!r} after {updates} updates; expected a finite number >= 0",
            )
        return float(found)


def own_schedule(key: str, entry: dict[str, Any], updates: int) -> Schedule:
    """Makes the schedule that an entry names.

    What it names is a class, or a function, that takes the entry's settings as keyword arguments
    and gives a callable ``updates -> weight``. That has no state: a run that goes on asks it for
    the weight after as many updates as it has made. A ``duration`` that it needs and the entry does
    not give is the whole run's. Importing the file runs its code.

    Args:
        key: Of the entry, for messages.
        entry: ``{kind: path.py:NAME, ...}``.
        updates: Of the actor in the whole run.

    Raises:
        ValueError: There is no such file, name or setting, it fails, or it gives something else.
    """
    parts = OwnParts(key, "kind", remedy=", and what is null is not passed")
    if "duration" not in entry and _needs_duration(key, entry["kind"]):
        entry = {**entry, "duration": max(updates, 1)}
    made = parts.make(entry)
    if not callable(made):
        raise parts.refused(
            entry, f"gives {type(made).__name__}; expected a callable: number of updates -> weight"
        )
    schedule = OwnSchedule(made, parts, entry)
    first, again = schedule(0), schedule(0)
    if first != again:
        raise parts.refused(
            entry,
            f"gives {first:g} and then {again:g} after 0 updates; a weight may depend on the "
            "number of updates alone, or a resumed run would have others",
        )
    return schedule


def _needs_duration(key: str, where: str) -> bool:
    make = load_function(key, where)
    try:
        duration = inspect.signature(make).parameters.get("duration")
    except (TypeError, ValueError):  # of a class that is not written in Python
        return False
    return duration is not None and duration.default is inspect.Parameter.empty
