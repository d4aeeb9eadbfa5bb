"""Which episodes join the demonstration distribution (paper, sections III-E and III-E.1)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass as settings

from pipeline.data.buffers import EpisodeRecord, GrownDemonstrations
from pipeline.data.episodes import FinishedEpisode
from pipeline.data.rows import TransitionRows
from pipeline.settings import STRICT, Count, Share


@settings(frozen=True, kw_only=True, config=STRICT)
class AdmissionSettings:
    """Which whole episodes may join D."""

    success: bool = True  # the episode must have succeeded
    at_end: bool = False  # its last step must have
    min_progress: float | None = None  # its largest progress must exceed this
    min_return: float | None = None
    quantile: Share | None = None  # of the last `window` training returns, to be reached as well
    window: Count = 50  # training episodes


@settings(frozen=True, kw_only=True, config=STRICT)
class GrowthSettings:
    """Demonstrations that grow: SID (paper III-E) and ILD (paper III-E.1)."""

    self_imitation: bool = False  # admit the policy's own good training episodes
    bc_model: bool = False  # admit the good episodes of the BC model, before training starts
    bc_model_episodes: Count = 250  # episodes it is rolled out for
    capacity: Count = 100_000  # rows; the oldest grown episode leaves first, the core never does
    share: Share | None = None  # of the demonstration rows, once full; None = by number of rows
    admission: AdmissionSettings = field(default_factory=AdmissionSettings)


@dataclass(frozen=True)
class AdmissionRule:
    """An episode is good if it clears every bound that is set.

    The paper admits "good policy outputs" and "examples with good rewards" without a number.

    Deviation: the default bound is success, not a return, since the return of a successful episode
    depends on where it started and a bound on it would drop the hard starts;
    ``growth.admission.min_return`` sets one and ``success=false`` lifts the other.
    """

    success: bool = True
    """Whether the episode must have succeeded."""
    min_progress: float | None = None
    """In the task's unit; the largest progress of the episode must exceed it."""
    min_return: float | None = None
    """Undiscounted return that must be reached."""
    at_end: bool = False
    """Whether its last step must have succeeded: a door that was flung open may be shut by then."""

    def __post_init__(self) -> None:
        bounds = (self.min_progress, self.min_return)
        if not self.success and not self.at_end and bounds == (None, None):
            raise ValueError(
                "growth.admission admits every episode: set success=true, at_end=true, or "
                "min_progress or min_return to a bound."
            )

    def admits(self, episode: FinishedEpisode) -> bool:
        """Whether ``episode`` is good.  Where the task does not tell, it is not."""
        if self.success and not episode.success:
            return False
        if self.at_end and not episode.success_at_end:
            return False
        if self.min_progress is not None and not episode.max_progress > self.min_progress:
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
class EpisodeAdmission:
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
            success=episode.success,
            max_progress=episode.max_progress,
            frame=frame,
        )
        self.grown.add(self.to_rows(episode.trajectory), record)
