"""Which episodes are filmed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pipeline.files import again
from pipeline.files.run_files import EVALUATION, RunDirectoryError
from pipeline.results.evaluation_files import EPISODES, beside, load_columns, load_evaluation

if TYPE_CHECKING:
    from pipeline.recipe import Recipe

DEFAULT: Final = 3
"""Episodes where nobody says how many."""


@dataclass(frozen=True)
class Choice:
    """Episodes of the task's numbered list; at most one of the three is given.

    Attributes:
        episodes: the first so many.
        starts: these, by number, in this order.
        worst: so many that went worst in the last ``make eval``.

    Raises:
        ValueError: a number is out of range, or several are given.
    """

    episodes: int | None = None
    starts: tuple[int, ...] = ()
    worst: int | None = None

    def __post_init__(self) -> None:
        given = {
            "EPISODES": self.episodes,
            "STARTS": ",".join(map(str, self.starts)) or None,
            "WORST": self.worst,
        }
        told = [f"{name}={value}" for name, value in given.items() if value is not None]
        if len(told) > 1:
            raise ValueError(f"{' and '.join(told)} each say which episodes: give one of them")
        for name, count in (("EPISODES", self.episodes), ("WORST", self.worst)):
            if count is not None and count < 1:
                raise ValueError(f"{name}={count} must be at least 1")
        if any(number < 0 for number in self.starts):
            raise ValueError(f"{told[0]}: episodes are numbered from 0")

    @classmethod
    def parse(cls, episodes: int | None, starts: str | None, worst: int | None) -> Choice:
        """From a command line, where ``starts`` is ``3,17``.

        Raises:
            ValueError: As the class does, or it is no list of whole numbers.
        """
        try:
            numbers = tuple(int(part) for part in (starts or "").split(",") if part.strip())
        except ValueError as error:
            raise ValueError(
                f"STARTS={starts} is no list of episodes; expected numbers like 3,17"
            ) from error
        if starts is not None and not numbers:
            raise ValueError("STARTS= names no episode; expected numbers like 3,17")
        return cls(episodes, numbers, worst)

    @property
    def needs_list(self) -> str | None:
        """What of it needs a task that numbers its episodes; None if nothing does."""
        if self.worst is not None:
            return f"WORST={self.worst}"
        return f"STARTS={','.join(map(str, self.starts))}" if self.starts else None

    def numbers(self, run_dir: Path, recipe: Recipe) -> list[int]:
        """The episodes' numbers.

        Raises:
            RunDirectoryError: the worst are asked for, and there is no evaluation of this list.
        """
        if self.worst is not None:
            return worst_of(_evaluated(run_dir, recipe))[: self.worst]
        return list(self.starts) or list(range(self.episodes or DEFAULT))


def worst_of(episodes: Mapping[str, Sequence[Any]]) -> list[int]:
    """Numbers of evaluated episodes, the worst first.

    Failures come before successes; among them counts how far the episode got (``progress_max``,
    where the task tells it), then its return.

    Args:
        episodes: columns of ``episodes.csv``.
    """
    keys = [episodes[key] for key in ("return", "progress_max", "success_once") if key in episodes]
    order = np.lexsort([np.asarray(key, dtype=np.float64) for key in keys])
    return [int(episodes["episode"][i]) for i in order]


def _evaluated(run_dir: Path, recipe: Recipe) -> dict[str, list[Any]]:
    made_from = load_evaluation(run_dir).made_from
    wanted = {"task": recipe.task.name, "evaluation_seed": recipe.evaluation.seed}
    for key, value in wanted.items():
        found = getattr(made_from, key)
        if found != value:
            raise RunDirectoryError(
                f"{run_dir / EVALUATION} is of {key} {found}, not {value}, whose "
                f"worst episodes are asked for; make it again with: {again.evaluate(run_dir)}"
            )
    return load_columns(beside(run_dir / EVALUATION, EPISODES))
