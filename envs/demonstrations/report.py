"""One line per demonstration: is the file what it should be, and does the task agree?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Final

import numpy as np
from tabulate import tabulate

from envs.demonstrations.episode import Episode
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import reward_agreement


@dataclass(frozen=True)
class ReplayError:
    """How far a re-simulated episode is from its recording, over all observation entries.

    Attributes:
        median: median of |recorded - simulated|.
        maximum: largest |recorded - simulated|.
    """

    median: float
    maximum: float


CLIPPED: Final = "clipped entries"


@dataclass(frozen=True)
class EpisodeReport:
    """What `make demos-check` prints about one demonstration.

    Attributes:
        source: name of the source.
        episode: index in the source.
        kind: see `Provenance.kind`.
        length: transitions.
        return_at_horizon: sum of the rewards within the task's horizon (its own after replay).
        success: whether the task is accomplished; None if nobody knows.
        max_progress: largest progress, in the task's unit; NaN if nobody knows.
        recorded_max_progress: the same in the file, before re-simulation.
        clipped_entries: action entries outside [-1, 1].
        replay_error_median: median |recorded - simulated observation|; NaN if not re-simulated.
        replay_error_max: the largest; NaN if not re-simulated.
        reward_agreement: share of the file's rewards that agree with the task's; NaN if unknown.
        recorded_length: transitions in the file.
    """

    source: str
    episode: int
    kind: str
    length: int
    return_at_horizon: float
    success: bool | None
    max_progress: float
    recorded_max_progress: float
    clipped_entries: int
    replay_error_median: float
    replay_error_max: float
    reward_agreement: float
    recorded_length: int


def replay_error(recorded: Episode, simulated: Episode) -> ReplayError:
    """Compare a recording with its re-simulation, over the steps that both have."""
    steps = min(recorded.length, simulated.length) + 1
    error = np.abs(recorded.observations[:steps] - simulated.observations[:steps])
    return ReplayError(median=float(np.median(error)), maximum=float(error.max()))


def report_episode(recorded: Episode, used: Episode, schema: DemoSchema) -> EpisodeReport:
    """Describe one demonstration.

    Args:
        recorded: the episode as the file holds it.
        used: what training sees: its re-simulation, or ``recorded`` itself.
        schema: of the task.
    """
    median = maximum = math.nan
    if used.provenance.kind == "resimulated":
        error = replay_error(recorded, used)
        median, maximum = error.median, error.maximum
    return EpisodeReport(
        source=used.provenance.source,
        episode=used.provenance.episode,
        kind=used.provenance.kind,
        length=used.length,
        return_at_horizon=used.return_at(schema.horizon),
        success=used.succeeds,
        max_progress=used.max_progress,
        recorded_max_progress=recorded.max_progress,
        clipped_entries=recorded.clipped_entries,
        replay_error_median=median,
        replay_error_max=maximum,
        reward_agreement=reward_agreement(recorded, schema),
        recorded_length=recorded.length,
    )


def format_reports(reports: Sequence[EpisodeReport], unit: str = "") -> str:
    """The reports as a text table, one row per demonstration; what nobody knows is a dash.

    A column in which nobody knows anything is left out, and that of clipped entries where there are
    none.

    Args:
        reports: of one source.
        unit: of the task's progress.
    """
    of_progress = f"progress [{unit}]" if unit else "progress"
    headers = (
        "source", "episode", "kind", "length", "return", "success", f"max {of_progress}",
        f"recorded {of_progress}", CLIPPED, "replay error (median)",
        "replay error (max)", "reward agreement",
    )  # fmt: skip
    told = [astuple(row)[: len(headers)] for row in reports]
    rows = [["-" if _unknown(value) else value for value in row] for row in told]
    shown = {
        header: column
        for header, *column in zip(headers, *rows, strict=True)
        if any(value != "-" for value in column) and (header != CLIPPED or any(column))
    }
    return tabulate(shown, headers="keys", floatfmt=".3f")


def saturated_share(episodes: Sequence[Episode], within: float = 0.01) -> float:
    """Share of action entries at the bounds, after clipping.

    Where it is large, a Gaussian squashed by tanh has no finite likelihood of what is shown, and a
    squared error is the safer imitation error.

    Args:
        episodes: of a set.
        within: of a bound counts as at it, as a share of the distance between 0 and the bound.

    Returns:
        In [0, 1]; NaN without episodes.
    """
    entries = sum(episode.actions.size for episode in episodes)
    at_bounds = sum(int((np.abs(e.actions) >= 1.0 - within).sum()) for e in episodes)
    return at_bounds / entries if entries else math.nan


def _unknown(value: object) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))
