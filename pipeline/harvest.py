"""Which episodes join the demonstration distribution (paper, sections III-E and III-E.1)."""

from __future__ import annotations

from dataclasses import dataclass

from envs.door.task import SUCCESS_ANGLE
from pipeline.buffers import EpisodeRecord, GrownDemonstrations
from pipeline.episodes import FinishedEpisode
from pipeline.rows import TransitionRows


@dataclass(frozen=True)
class AdmissionRule:
    """An episode is good if it clears every bound that is set.

    The paper admits "good policy outputs" and "examples with good rewards" without a number.

    Deviation: the default bound is the angle of the paper's last threshold, not a return, since the
    return of a successful episode depends on where the door stands and a bound on it would drop the
    hard doors; ``growth.admission.min_return`` sets one and ``min_angle=null`` lifts the angle.
    """

    min_angle: float | None = SUCCESS_ANGLE
    """rad; the largest hinge angle of the episode must exceed it."""
    min_return: float | None = None
    """Undiscounted return that must be reached."""

    def __post_init__(self) -> None:
        if self.min_angle is None and self.min_return is None:
            raise ValueError(
                "growth.admission admits every episode: set min_angle or min_return to a bound."
            )

    def admits(self, episode: FinishedEpisode) -> bool:
        """Whether ``episode`` is good.  Without a hinge, an angle bound admits nothing."""
        if self.min_angle is not None and not episode.max_angle > self.min_angle:
            return False
        return self.min_return is None or episode.episode_return >= self.min_return


@dataclass(frozen=True)
class Harvest:
    """Admits good episodes to the grown demonstrations, with their provenance."""

    grown: GrownDemonstrations
    rule: AdmissionRule
    to_rows: TransitionRows
    source: str

    def __call__(self, episode: FinishedEpisode, frame: int) -> None:
        """Offers one finished episode."""
        if not self.rule.admits(episode):
            return
        record = EpisodeRecord(
            source=self.source,
            length=episode.length,
            episode_return=episode.episode_return,
            max_angle=episode.max_angle,
            frame=frame,
        )
        self.grown.add(self.to_rows(episode.trajectory), record)
