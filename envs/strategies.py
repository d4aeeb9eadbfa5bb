"""How an episode was done: what a task may tell of it besides success and progress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

if TYPE_CHECKING:  # in annotations alone: the command line starts without torch
    from tensordict import TensorDictBase


@dataclass(frozen=True)
class Ways:
    """How E episodes were done.

    Attributes:
        names: of the way of each, one of `Strategies.words`, [E].
        figures: of the task's own, for ``evaluation.json``.
        columns: likewise for ``episodes.csv``, [E] each.
    """

    names: Sequence[str]
    figures: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Sequence[Any]] = field(default_factory=dict)


class Strategies(Protocol):
    """Tells the ways of a task's episodes, from what its environments write about them."""

    @property
    def words(self) -> Mapping[str, str]:
        """All ways by name, in the order of tables, and what each means."""
        ...

    @property
    def columns(self) -> tuple[str, ...]:
        """What environments write besides where `EnvOptions.strategies` asks, [N, K] each."""
        ...

    def told(
        self,
        seen: Mapping[str, NDArray[Any]],
        progress: NDArray[Any] | None,
        success: NDArray[Any] | None,
    ) -> Ways:
        """The ways of E episodes of at most T steps.

        Args:
            seen: `columns` after each step, [E, T, K]; zeros behind an episode's end.
            progress: [E, T], NaN behind the end; None where the task does not tell.
            success: bool [E, T], false behind the end; None likewise.
        """
        ...

    def now(self, seen: TensorDictBase) -> str:
        """The state of the first copy in a line, for films; ``seen`` [N] holds `columns`."""
        ...


def shares(names: Sequence[str], ways: Sequence[str]) -> dict[str, float]:
    """The share of each way among the names [E], E >= 1."""
    counted = Counter(names)
    return {way: counted[way] / len(names) for way in ways}
