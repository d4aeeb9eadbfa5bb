"""One line per demonstration: is the file what it should be, and does our physics agree?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

from tabulate import tabulate

from envs.demonstrations.episode import Episode
from envs.demonstrations.resimulation import replay_error
from envs.demonstrations.validation import reward_agreement
from envs.door import task

_HEADERS = (
    "source", "episode", "kind", "length", f"return at {task.HORIZON}", "max angle [rad]",
    "recorded angle [rad]", "clipped entries", "replay error (median)", "replay error (max)",
    "reward agreement",
)  # fmt: skip


@dataclass(frozen=True)
class EpisodeReport:
    """What `make demos-check` prints about one demonstration.

    Attributes:
        source: name of the source.
        episode: index in the source.
        kind: see `Provenance.kind`.
        length: transitions.
        return_at_horizon: sum of the first 200 rewards (the task's own after re-simulation).
        max_angle: largest hinge angle in rad.
        recorded_max_angle: the same in the file, before re-simulation.
        clipped_entries: action entries outside [-1, 1].
        replay_error_median: median |recorded - simulated observation|; NaN if not re-simulated.
        replay_error_max: the largest; NaN if not re-simulated.
        reward_agreement: share of the file's rewards that agree with the task's.
    """

    source: str
    episode: int
    kind: str
    length: int
    return_at_horizon: float
    max_angle: float
    recorded_max_angle: float
    clipped_entries: int
    replay_error_median: float
    replay_error_max: float
    reward_agreement: float


def report_episode(recorded: Episode, used: Episode) -> EpisodeReport:
    """Describe one demonstration.

    Args:
        recorded: the episode as the file holds it.
        used: what training sees: its re-simulation, or ``recorded`` itself.
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
        return_at_horizon=used.return_at(task.HORIZON),
        max_angle=used.max_angle,
        recorded_max_angle=recorded.max_angle,
        clipped_entries=recorded.clipped_entries,
        replay_error_median=median,
        replay_error_max=maximum,
        reward_agreement=reward_agreement(recorded),
    )


def format_reports(reports: Sequence[EpisodeReport]) -> str:
    """The reports as a text table, one row per demonstration, NaN as a dash."""
    rows = [
        ["-" if isinstance(value, float) and math.isnan(value) else value for value in astuple(row)]
        for row in reports
    ]
    return tabulate(rows, headers=_HEADERS, floatfmt=".3f")
