"""From a source's name to the episodes that training uses."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from envs.demonstrations.episode import Episode, content_hash
from envs.demonstrations.multiplication import multiply_cached
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.report import EpisodeReport, report_episode
from envs.demonstrations.resimulation import resimulate as resimulate_episodes
from envs.demonstrations.selection import (
    ended_at,
    highest_returns,
    require_end_angle,
    require_share,
)
from envs.demonstrations.sources import open_source
from envs.door import task


@dataclass(frozen=True)
class DemonstrationSet:
    """Demonstrations ready for training.

    Attributes:
        episodes: re-simulated (or relabelled), perhaps multiplied, and selected episodes.
        source: name of the source.
        content_hash: SHA-256 over ``episodes``, to record with a run.
        reports: one row per episode *of the source*, in its order.
    """

    episodes: tuple[Episode, ...]
    source: str
    content_hash: str
    reports: tuple[EpisodeReport, ...]

    @property
    def transitions(self) -> int:
        """Number of transitions over all episodes."""
        return sum(episode.length for episode in self.episodes)


def load_demonstrations(
    spec: str | Path,
    *,
    resimulate: bool = True,
    multiply: MultiplyConfig | None = None,
    num_threads: int | None = None,
    cache_dir: str | Path | None = None,
    limit: int | None = None,
    keep_best: float = 1.0,
    end_angle: float | None = None,
) -> DemonstrationSet:
    """Open, validate, re-simulate, perhaps multiply, and select demonstrations.

    Args:
        spec: see `envs.demonstrations.sources.open_source`.
        resimulate: replay the actions in our simulator from the reset pose. Otherwise the recorded
            observations are used with the task's reward.
        multiply: make many episodes out of few.
        num_threads: threads of the simulator, default all cores. No effect on the result.
        cache_dir: where multiplied episodes are kept between runs; None makes them every time.
        limit: use the first so many episodes of the source only.
        keep_best: share of the episodes, after multiplication, to keep: those of highest return.
        end_angle: end each of these where its hinge passes this angle (rad), see
            `envs.demonstrations.selection.ended_at`; None keeps whole episodes.

    Raises:
        DemonstrationError: anything is wrong with the source, or multiplication keeps nothing.
        ValueError: ``limit`` is below 1, or ``keep_best`` or ``end_angle`` is out of its
            range.
    """
    if limit is not None and limit < 1:
        raise ValueError(f"limit must be at least 1, got {limit}")
    require_share(keep_best)  # now, not after minutes of multiplication
    if end_angle is not None:
        require_end_angle(end_angle)
    source = open_source(spec)
    recorded = source.load()[:limit]
    if resimulate:
        used = resimulate_episodes(recorded, num_threads=num_threads)
    else:
        # The published rewards follow other formulas: one buffer must hold one reward.
        used = [dataclasses.replace(e, rewards=task.reward(e.observations[1:])) for e in recorded]
    reports = tuple(report_episode(r, u) for r, u in zip(recorded, used, strict=True))
    if multiply is not None:
        used = multiply_cached(used, multiply, num_threads=num_threads, cache_dir=cache_dir)
    used = highest_returns(used, keep_best)
    if end_angle is not None:
        used = ended_at(used, end_angle)  # after the choice: returns are those of whole episodes
    return DemonstrationSet(tuple(used), source.name, content_hash(used), reports)
