"""What a set of episodes achieved, the same figures for every task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from envs.intervals import wilson
from pipeline.non_finite import NonFiniteError


@dataclass(frozen=True)
class Rollouts:
    """Raw results of E episodes, at most T steps each.

    Attributes:
        returns: undiscounted return, [E].
        lengths: control steps, [E].
        success: whether the task was accomplished after each step, bool [E, T], false behind the
            end; None where the task does not tell.
        progress: progress after each step, [E, T], NaN behind the end; None likewise.
        stages: whether each episode ever reached each stage of the task, bool [E] by label.
    """

    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    success: NDArray[np.bool_] | None = None
    progress: NDArray[np.float32] | None = None
    stages: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    @classmethod
    def join(cls, waves: list[Self]) -> Self:
        """Puts waves of episodes behind one another."""
        return cls(
            returns=np.concatenate([wave.returns for wave in waves]),
            lengths=np.concatenate([wave.lengths for wave in waves]),
            success=_stacked([wave.success for wave in waves], False),
            progress=_stacked([wave.progress for wave in waves], np.nan),
            stages={
                label: np.concatenate([wave.stages[label] for wave in waves])
                for label in waves[0].stages
            },
        )


@dataclass(frozen=True)
class EpisodeMetrics:
    """Summary of E episodes. Shares are in 0..1; ``*_ci95`` are their Wilson intervals.

    Attributes:
        episodes: number of episodes E.
        return_mean: mean undiscounted return.
        return_std: standard deviation of the return over episodes (population).
        length_mean: mean episode length, control steps.
        success_once: share of episodes that succeeded at any step; None where the task does not
            tell. The same for the following.
        success_at_end: share of episodes that were successful at their last step.
        steps_to_success_median: median over the episodes that succeed of the first control step
            (from 1) of success; None also if there is none.
        success_share: mean over episodes of the share of control steps after which the task was
            accomplished, of the longest episode's steps: the horizon, unless all end before it.
        stages: share of episodes that ever reached each stage of the task, by label.
        progress_max_mean: mean over episodes of the largest progress; None if the task has none.
    """

    episodes: int
    return_mean: float
    return_std: float
    length_mean: float
    success_once: float | None = None
    success_once_ci95: tuple[float, float] | None = None
    success_at_end: float | None = None
    success_at_end_ci95: tuple[float, float] | None = None
    steps_to_success_median: float | None = None
    success_share: float | None = None
    stages: Mapping[str, float] = field(default_factory=dict)
    progress_max_mean: float | None = None

    def as_plain(self) -> dict[str, Any]:
        """For JSON: intervals become two-element lists."""
        return plain(asdict(self))


def summarise(rollouts: Rollouts) -> EpisodeMetrics:
    """Summarise episodes.

    Raises:
        NonFiniteError: a return is not finite.
    """
    if not np.isfinite(rollouts.returns).all():
        episode = int(np.flatnonzero(~np.isfinite(rollouts.returns))[0])
        raise NonFiniteError(
            f"the return of evaluation episode {episode} is {rollouts.returns[episode]}: the "
            "environment or the policy gave numbers that are not finite"
        )
    found: dict[str, Any] = {}
    if rollouts.success is not None:
        once = rollouts.success.any(axis=1)
        last = np.take_along_axis(rollouts.success, rollouts.lengths[:, None] - 1, axis=1)
        first = rollouts.success.argmax(axis=1) + 1
        found = {
            "success_once": float(once.mean()),
            "success_once_ci95": wilson(once),
            "success_at_end": float(last.mean()),
            "success_at_end_ci95": wilson(last),
            "steps_to_success_median": float(np.median(first[once])) if once.any() else None,
            "success_share": float(
                rollouts.success.sum(axis=1).mean() / int(rollouts.lengths.max())
            ),
        }
    if rollouts.progress is not None:
        found["progress_max_mean"] = float(np.nanmax(rollouts.progress, axis=1).mean())
    return EpisodeMetrics(
        episodes=len(rollouts.returns),
        return_mean=float(rollouts.returns.mean()),
        return_std=float(rollouts.returns.std()),
        length_mean=float(rollouts.lengths.mean()),
        stages={label: float(reached.mean()) for label, reached in rollouts.stages.items()},
        **found,
    )


def plain(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures for JSON: tuples become lists, mappings dicts."""
    return {
        key: list(value)
        if isinstance(value, tuple)
        else dict(value)
        if isinstance(value, Mapping)
        else value
        for key, value in figures.items()
    }


def _stacked(parts: list[Any], filler: Any) -> Any:
    if any(part is None for part in parts):
        return None
    width = max(part.shape[1] for part in parts)
    return np.concatenate(
        [np.pad(p, ((0, 0), (0, width - p.shape[1])), constant_values=filler) for p in parts]
    )
