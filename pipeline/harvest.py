"""Which episodes join the demonstration distribution (paper, sections III-E and III-E.1)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

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


class MovingBound:
    """A bound on the return that rises with the policy: a quantile of the last episodes' returns.

    A fixed bound ends up admitting everything that a learned policy does, good or middling.  All
    finished episodes count, failures too, so that a policy which unlearns lowers the bound again
    and does not starve.  Until ``window`` episodes have ended, none is better than usual.

    Args:
        quantile: Of the returns, in [0, 1): 0.5 admits the better half.
        window: Episodes that are remembered.

    Raises:
        ValueError: If either is out of range.
    """

    def __init__(self, quantile: float, window: int) -> None:
        if not 0.0 <= quantile < 1.0:
            raise ValueError(f"growth.admission.quantile must be in [0, 1), got {quantile}.")
        if window < 1:
            raise ValueError(f"growth.admission.window must be at least 1, got {window}.")
        self.quantile = quantile
        self.recent: deque[float] = deque(maxlen=window)

    def passes(self, episode_return: float) -> bool:
        """Whether the return reaches the bound of the episodes before it, which it then joins."""
        full = len(self.recent) == self.recent.maxlen
        good = full and episode_return >= float(np.quantile(self.recent, self.quantile))
        self.recent.append(episode_return)
        return good

    def state_dict(self) -> dict[str, Any]:
        """The remembered returns."""
        return {"recent": list(self.recent)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.recent = deque(state["recent"], maxlen=self.recent.maxlen)


@dataclass(frozen=True)
class Harvest:
    """Admits good episodes to the grown demonstrations, with their provenance."""

    grown: GrownDemonstrations
    rule: AdmissionRule
    to_rows: TransitionRows
    source: str
    bound: MovingBound | None = None
    """Sees every episode, whether the rule admits it or not."""

    def __call__(self, episode: FinishedEpisode, frame: int) -> None:
        """Offers one finished episode."""
        good = self.bound is None or self.bound.passes(episode.episode_return)
        if not good or not self.rule.admits(episode):
            return
        record = EpisodeRecord(
            source=self.source,
            length=episode.length,
            episode_return=episode.episode_return,
            max_angle=episode.max_angle,
            frame=frame,
        )
        self.grown.add(self.to_rows(episode.trajectory), record)
