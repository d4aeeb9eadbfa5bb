"""From a source's name to the episodes that training uses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from envs.demonstrations.episode import Episode, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.findings import Findings, Kind, Notes
from envs.demonstrations.multiplication_cache import multiply_cached
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.report import EpisodeReport, report_episode, saturated_share
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.selection import (
    ended_at,
    highest_returns,
    require_end_progress,
    require_share,
)
from envs.demonstrations.sources import open_source
from envs.task import Resimulate, Task


@dataclass(frozen=True)
class DemonstrationSet:
    """Demonstrations ready for training.

    Attributes:
        episodes: re-simulated (or relabelled), perhaps multiplied, and selected episodes.
        source: name of the source.
        content_hash: SHA-256 over ``episodes``, to record with a run.
        reports: one row per episode *of the source*, in its order.
        findings: what was dropped, joined, clipped or replaced on the way.
    """

    episodes: tuple[Episode, ...]
    source: str
    content_hash: str
    reports: tuple[EpisodeReport, ...]
    findings: Findings = field(default_factory=lambda: Findings(""))

    @property
    def transitions(self) -> int:
        """Number of transitions over all episodes."""
        return sum(episode.length for episode in self.episodes)

    @property
    def saturated_share(self) -> float:
        """Share of action entries within 1 % of their bounds, see `report.saturated_share`."""
        return saturated_share(self.episodes)


@dataclass(frozen=True)
class DemoOptions:
    """What is done to demonstrations on loading.

    Attributes:
        resimulate: replay the actions in the task from its own starts. Otherwise, and of episodes
            that hold no start, the recorded observations are used, with the task's reward where
            it can be computed.
        multiply: make many episodes out of few; None does not.
        limit: use the first so many episodes of the source only.
        keep_best: share of the episodes, after multiplication, to keep: those of highest return.
        end_progress: end each of these where its progress passes this bound, see
            `envs.demonstrations.selection.ended_at`; None keeps whole episodes.

    Raises:
        ValueError: ``limit`` is below 1, or ``keep_best`` or ``end_progress`` is out of its range.
    """

    resimulate: bool = True
    multiply: MultiplyConfig | None = None
    limit: int | None = None
    keep_best: float = 1.0
    end_progress: float | None = None

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise ValueError(f"limit must be at least 1, got {self.limit}")
        require_share(self.keep_best)
        if self.end_progress is not None:
            require_end_progress(self.end_progress, None)


def load_demonstrations(
    spec: str | Path,
    task: Task,
    options: DemoOptions | None = None,
    *,
    num_threads: int | None = None,
    cache_dir: str | Path | None = None,
    refused: list[DemonstrationError] | None = None,
) -> DemonstrationSet:
    """Open, validate, re-simulate, perhaps multiply, and select demonstrations.

    Args:
        spec: see `envs.demonstrations.sources.open_source`.
        task: what they are of.
        options: what is done to them.
        num_threads: threads of the simulator, default all cores. No effect on the result.
        cache_dir: where multiplied episodes are kept between runs; None makes them every time.
        refused: collects the errors of episodes of the source that do not pass, which are then left
            out; None raises the first.

    Raises:
        DemonstrationError: anything is wrong with the source, or multiplication keeps nothing.
        MissingCapabilityError: the task cannot do what the options ask for.
        ValueError: a bound is out of the range of the task's progress.
    """
    options = options or DemoOptions()
    schema: DemoSchema = task.require("demos", f"demos.source={spec}")
    if options.end_progress is not None:  # now, not after minutes of multiplication
        require_end_progress(options.end_progress, schema.full_progress)
    source = open_source(spec)
    notes = Notes()
    recorded = source.load(schema, notes, refused)[: options.limit]
    if options.resimulate:
        resimulate = task.require("resimulate", "demos.resimulate=true")
        recorded, used = _replayed(recorded, resimulate, num_threads, notes, refused)
    else:
        used = recorded
    used = [_relabelled(episode, schema) for episode in used]
    _require_rewards(used)
    reports = tuple(report_episode(r, u, schema) for r, u in zip(recorded, used, strict=True))
    for report in reports:
        if not math.isnan(report.reward_agreement):
            others = round((1.0 - report.reward_agreement) * report.recorded_length)
            notes.add(Kind.OTHER_REWARDS, others, f"{report.source}, episode {report.episode}")
    if options.multiply is not None and used:
        vary = task.require("vary", "demos.multiply.enabled=true")
        multiply = options.multiply
        # Else returns of whole episodes decide, or their last steps.
        if options.keep_best == 1.0 and not multiply.hold:
            multiply = dataclasses.replace(multiply, end_progress=options.end_progress)
        used = multiply_cached(used, multiply, vary, num_threads=num_threads, cache_dir=cache_dir)
    used = highest_returns(used, options.keep_best)
    if options.end_progress is not None:
        # After the choice: returns are those of whole episodes.
        used = ended_at(used, options.end_progress)
    findings = notes.findings(source.name)
    return DemonstrationSet(tuple(used), source.name, content_hash(used), reports, findings)


def _replayed(
    recorded: list[Episode],
    resimulate: Resimulate,
    num_threads: int | None,
    notes: Notes,
    refused: list[DemonstrationError] | None,
) -> tuple[list[Episode], list[Episode]]:
    """Episodes that can be replayed, and their replays."""
    try:
        return recorded, resimulate(recorded, num_threads=num_threads)
    except DemonstrationError:
        if refused is None:
            raise
    kept, used = [], []
    for episode in recorded:  # one by one, to tell which cannot
        try:
            used += resimulate([episode], num_threads=num_threads)
            kept.append(episode)
        except DemonstrationError as error:
            notes.add(Kind.REFUSED, 1, error)
            refused.append(error)
    return kept, used


def _relabelled(episode: Episode, schema: DemoSchema) -> Episode:
    """With the task's reward: files follow other formulas, and one buffer must hold one reward.

    A replay has it already; tasks may leave episodes that they cannot begin as they were recorded.
    """
    if episode.provenance.kind == "resimulated":
        return episode
    before, after = episode.observations[:-1], episode.observations[1:]
    if schema.step_reward is not None:
        rewards: Any = schema.step_reward(before, episode.played_actions.clip(-1.0, 1.0), after)
    elif schema.reward is not None:
        rewards = schema.reward(after)
    else:
        return episode
    return dataclasses.replace(episode, rewards=np.asarray(rewards, dtype=np.float32))


def _require_rewards(episodes: Sequence[Episode]) -> None:
    for episode in episodes:
        if np.isnan(episode.rewards).any():
            raise DemonstrationError(
                episode.provenance,
                "has no rewards, and the task cannot compute them",
                "Store one reward per action, or name a function: task.reward=path.py:function",
            )
