"""What reading a source did to it: nothing is dropped, joined or rescaled without being counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType


class Kind(StrEnum):
    """Everything that is done to a source, or known to be missing from it."""

    AFTER_END = "transitions behind a terminal observation, dropped"
    CLIPPED = "action entries beyond the bounds, clipped"
    COLUMNS = "episodes with observation columns that the task does not have, dropped"
    ENDS_FOUND = "episode ends that no flag tells, found where next_observations do not continue"
    ENDS_UNTOLD = (
        "episode ends that do not tell a terminal state from a time limit, taken as limits"
    )
    IGNORED_FILES = "files that are no demonstrations, left alone"
    IN_UNIT_BOX = "files whose actions may be normalised already, taken in the task's units"
    JOINED = "cuts at a time limit at which an episode goes on, joined"
    KEYS_UNUSED = "episodes with observation arrays that are not used"
    LAST_ACTION = "last actions without the observation after them, dropped"
    NO_REWARDS = "episodes without rewards in the file"
    NO_TIMEOUTS = "files without timeouts: time limits between their terminals cannot be seen"
    OTHER_REWARDS = "rewards of another formula than the task's, replaced"
    REFUSED = "episodes refused"
    SHORT = "pieces without a transition, dropped"
    UNALIGNED = "success or progress columns of another length, not used"


@dataclass(frozen=True)
class Finding:
    """One kind of thing found in a source.

    Attributes:
        kind: what it is.
        count: how many, in the unit that the kind names.
        first: where it was first found, with what belongs to it.
    """

    kind: Kind
    count: int
    first: str

    def __str__(self) -> str:
        return f"{self.count:,} {self.kind} (first: {self.first})"


@dataclass(frozen=True)
class Findings:
    """All that was found in one source.

    Attributes:
        source: its name.
        found: by kind, in the order in which they were first found.
    """

    source: str
    found: Mapping[Kind, Finding] = field(default_factory=lambda: MappingProxyType({}))

    def count(self, kind: Kind) -> int:
        """How many of ``kind``, 0 if none."""
        return self.found[kind].count if kind in self.found else 0

    def __str__(self) -> str:
        """One line per kind."""
        return "\n".join(map(str, self.found.values()))


class Notes:
    """Takes down findings while a source is read; `findings` is the result."""

    def __init__(self) -> None:
        self._found: dict[Kind, Finding] = {}

    def add(self, kind: Kind, count: int, where: object) -> None:
        """Count ``count`` more of ``kind``; 0 is nothing."""
        if count > 0:
            before = self._found.get(kind)
            total, first = (0, str(where)) if before is None else (before.count, before.first)
            self._found[kind] = Finding(kind, total + count, first)

    def findings(self, source: str) -> Findings:
        """What has been taken down so far."""
        return Findings(source, MappingProxyType(dict(self._found)))
