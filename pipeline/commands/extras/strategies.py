"""``make eval``'s ``strategies``: how the episodes were done, of a task that can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.intervals import wilson
from envs.strategies import Strategies, Ways, shares
from pipeline.act.metrics import Rollouts
from pipeline.act.recorder import ColumnRecorder
from pipeline.commands.extras import Findings, Subject
from pipeline.results.evaluation_files import STRATEGY


@dataclass(frozen=True)
class StrategiesAsked:
    """Whether to tell strategies.

    Attributes:
        asked: None does where the task can.
    """

    asked: bool | None = None

    def __call__(self, subject: Subject) -> StrategiesTold | None:
        """The extra.

        Raises:
            MissingCapabilityError: It is asked for and the task cannot tell.
        """
        if self.asked:
            subject.task.require("strategies", "make eval STRATEGIES=1")
        strategies = None if self.asked is False else subject.task.strategies
        return None if strategies is None else StrategiesTold(strategies)


@dataclass(frozen=True)
class StrategiesTold:
    """Records what a task tells its strategies from."""

    strategies: Strategies

    @property
    def env_options(self) -> Mapping[str, Any]:
        """Environments write it."""
        return {"strategies": True}

    @cached_property
    def recorder(self) -> ColumnRecorder:
        """Keeps it."""
        return ColumnRecorder(self.strategies.columns)

    def findings(self, rollouts: Rollouts) -> Findings:
        """Shares of the ways, and what the task adds to them."""
        seen = self.recorder.joined(len(rollouts.lengths))
        ways = self.strategies.told(seen, rollouts.progress, rollouts.success)
        figures = figures_of(ways, self.strategies.words, rollouts)
        return Findings({"strategies": figures}, {STRATEGY: list(ways.names), **ways.columns})


def figures_of(ways: Ways, words: Mapping[str, str], rollouts: Rollouts) -> dict[str, Any]:
    """For ``evaluation.json``: ``shares`` and what else docs/metrics.md lists, and the task's own.

    Args:
        ways: Of E episodes.
        words: Of all ways.
        rollouts: The episodes.
    """
    return {
        "shares": shares(ways.names, list(words)),
        "shares_ci95": {way: list(wilson([way == name for name in ways.names])) for way in words},
        **_at_end(ways.names, list(words), rollouts),
        "words": dict(words),
        **ways.figures,
    }


def _at_end(names: Sequence[str], words: Sequence[str], rollouts: Rollouts) -> dict[str, Any]:
    """Which episodes are still a success after their last step, and how many are one no more."""
    if rollouts.success is None:
        return {}
    last = rollouts.lengths[:, None] - 1
    kept = np.take_along_axis(rollouts.success, last, axis=1)[:, 0]
    lost = rollouts.success.any(axis=1) & ~kept

    def kept_of(way: str) -> float | None:
        of_way: NDArray[np.bool_] = kept[[name == way for name in names]]
        return float(of_way.mean()) if of_way.size else None

    return {
        "kept_at_end": {way: kept_of(way) for way in words},
        "lost_at_end": float(lost.mean()),
        "lost_at_end_ci95": list(wilson(lost)),
    }
