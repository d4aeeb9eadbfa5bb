"""The core of D, ready for the buffers."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDictBase

from envs import Task
from envs.demonstrations import (
    DemonstrationError,
    DemonstrationSet,
    DemoOptions,
    MultiplyConfig,
    load_demonstrations,
    to_tensordict,
)
from envs.demonstrations.episode import Episode
from envs.demonstrations.findings import Kind
from envs.steps import counted_steps
from pipeline.data.returns import TO_END
from pipeline.data.rows import TransitionRows
from pipeline.learn.networks import ActorSettings, CriticSettings, ObservationNormalizer
from pipeline.settings import STRICT, Count, Multiple, NotNegative, Positive, Rate, Seed, Share

_logger = logging.getLogger(__name__)


@settings(frozen=True, kw_only=True, config=STRICT)
class MultiplySettings:
    """Demonstration multiplication: replay at other speeds and starts, keep what succeeds."""

    enabled: bool = False
    target_episodes: Count = 350  # episodes to keep
    max_attempts: Count = 4000  # give up after so many
    seed: Seed = 0
    noise_scale: Rate = 0.08  # largest AR(1) action noise that is executed but not recorded
    speed_low: Positive = 1.1  # slowest playback speed (1 = as recorded)
    speed_high: Positive = 1.6
    # Equal parts of that range; those in which a demonstration succeeds are tried more often.
    speed_bins: Count = 1  # 1 = all speeds alike
    # No demonstration gives more than so many times its even share. A larger one takes fewer
    # attempts, since demonstrations that hardly ever succeed are needed less.
    balance: Multiple = 1.5
    min_progress: float | None = None  # what an attempt must get beyond; None = success

    hold: bool = False  # they are a success, or beyond min_progress, at their last step too

    def __post_init__(self) -> None:
        for low, high in (
            ("speed_low", "speed_high"),
            ("target_episodes", "max_attempts"),
            ("speed_bins", "max_attempts"),
        ):
            least, most = getattr(self, low), getattr(self, high)
            if least > most:
                raise ValueError(
                    f"demos.multiply.{low}={least} is more than demos.multiply.{high}={most}"
                )

    def config(self) -> MultiplyConfig | None:
        """What multiplication takes; None if it is off."""
        if not self.enabled:
            return None
        return MultiplyConfig(
            target_episodes=self.target_episodes,
            max_attempts=self.max_attempts,
            seed=self.seed,
            noise_scale=self.noise_scale,
            speed_low=self.speed_low,
            speed_high=self.speed_high,
            speed_bins=self.speed_bins,
            balance=self.balance,
            min_progress=self.min_progress,
            hold=self.hold,
        )


@settings(frozen=True, kw_only=True, config=STRICT)
class DemosSettings:
    """Where the demonstrations D come from and what is done to them on loading."""

    source: str = "bundled"  # bundled | path | minari:ID
    # Replay in the task from its own starts: states a policy will see. None = where the task can.
    resimulate: bool | None = None
    limit: Count | None = None  # use only the first N demonstrations
    # Train on the others where episodes of the source do not pass; else the first of them ends it.
    skip_refused: bool = False
    held_out: NotNegative = 0  # episodes, after multiplication, that only diagnostics see
    multiply: MultiplySettings = field(default_factory=MultiplySettings)
    # The action in the critics' rows of multiplied demonstrations: the executed one (with noise,
    # what their observations and rewards follow from) or the clean one, which is imitated.
    critic_action: Literal["executed", "clean"] = "executed"
    keep_best: Share = 1.0  # share of the episodes, after multiplication: those of highest return
    end_progress: Positive | None = (
        None  # episodes end where their progress passes it; None = whole
    )

    def options(self, task: Task) -> DemoOptions:
        """What loading takes, for this task."""
        can = task.resimulate is not None
        return DemoOptions(
            resimulate=can if self.resimulate is None else self.resimulate,
            multiply=self.multiply.config(),
            limit=self.limit,
            keep_best=self.keep_best,
            end_progress=self.end_progress,
        )


@dataclass(frozen=True)
class Demonstrations:
    """The core of D, ready for the buffers."""

    rows: TensorDictBase
    """Transitions [R] of the episodes to train on."""
    held_out: TensorDictBase | None
    """Transitions of the ``demos.held_out`` last episodes, which only diagnostics see."""
    content_hash: str
    """Of the episodes, for caches and for the record."""
    source: str
    saturated_share: float
    """Of the demonstrated action entries, those within 1 % of a bound."""
    success_share: float | None
    """Of the episodes, those that accomplish the task; None if nobody knows."""
    simulator_steps: int = 0
    """Control steps that re-simulating and multiplying took."""
    episodes: Sequence[Episode] = ()
    """What the rows to train on were made of."""

    def rewarded(self, factor: float) -> Demonstrations:
        """The same with this factor on the rewards of all rows."""
        return (
            self
            if factor == 1.0
            else replace(
                self,
                rows=_rewarded(self.rows, factor),
                held_out=None if self.held_out is None else _rewarded(self.held_out, factor),
            )
        )

    def normalizer(self) -> ObservationNormalizer:
        """Standardisation by the mean and standard deviation of the demonstrated observations."""
        observation = self.rows["observation"]
        # Of a single row, torch's estimate of the deviation is 0/0.
        std = observation.std(0) if len(observation) > 1 else torch.zeros_like(observation[0])
        return ObservationNormalizer(observation.mean(0), std)


def make_normalizer(
    part: ActorSettings | CriticSettings, demos: Demonstrations | None
) -> ObservationNormalizer | None:
    """The standardisation that a network asks for, from the statistics of the demonstrations.

    Raises:
        ValueError: If one is asked for but there are no demonstrations.
    """
    if not part.normalise_observations:
        return None
    if demos is None:
        raise ValueError(
            "normalise_observations=true needs demonstrations, whose statistics it uses, but this "
            "composition has none: set actor.normalise_observations=false and "
            "critic.normalise_observations=false."
        )
    return demos.normalizer()


def _rewarded(rows: TensorDictBase, factor: float) -> TensorDictBase:
    """A copy, as ``TransitionRows`` with this scale would have made it."""
    scaled = rows.copy()
    for key in (("next", "reward"), (TO_END, "reward")):
        if (reward := rows.get(key, None)) is not None:
            scaled[key] = reward * factor
    return scaled


def success_share(episodes: Sequence[Episode]) -> float | None:
    """Share of the episodes that succeed; None if that is not known of every one."""
    known = [episode.succeeds for episode in episodes if episode.succeeds is not None]
    return sum(known) / len(known) if known and len(known) == len(episodes) else None


def make_demonstrations(
    demos: DemosSettings,
    task: Task,
    to_rows: TransitionRows,
    *,
    cache_dir: Path,
    num_threads: int | None,
) -> Demonstrations:
    """Loads, checks, re-simulates and multiplies the demonstrations as configured.

    Raises:
        DemonstrationError: If they are not usable.
        ValueError: If as many or more are to be held out as there are.
    """
    if demos.resimulate is None and task.resimulate is None:
        _logger.info(
            "task %s cannot replay recorded episodes: the demonstrations are used as they were "
            "recorded", task.name,
        )  # fmt: skip
    refused: list[DemonstrationError] | None = [] if demos.skip_refused else None
    with counted_steps() as steps:
        loaded: DemonstrationSet = load_demonstrations(
            demos.source, task, demos.options(task), num_threads=num_threads, cache_dir=cache_dir,
            refused=refused,
        )  # fmt: skip
    if refused:
        if not loaded.episodes:
            raise refused[0]
        _logger.warning(
            "demos.skip_refused: %d of %d episodes of %s are left out, the first because %s",
            len(refused), len(loaded.reports) + len(refused), loaded.source, refused[0],
        )  # fmt: skip
    if (remark := loaded.findings.found.get(Kind.IN_UNIT_BOX)) is not None:
        _logger.warning("demos.source: %s", remark.first)
    count = len(loaded.episodes) - demos.held_out
    if count < 1:
        raise ValueError(
            f"demos.held_out must leave demonstrations to train on, got {demos.held_out} of "
            f"{len(loaded.episodes)} episodes."
        )
    steps_kept = sum(episode.length for episode in loaded.episodes[:count])
    apart = f" ({demos.held_out} more are held out)" if demos.held_out else ""
    _logger.info("demonstrations: %d episodes, %s steps%s", count, f"{steps_kept:,}", apart)
    executed = demos.critic_action == "executed"
    rows = [to_rows(episode) for episode in to_tensordict(loaded.episodes, executed=executed)]
    return Demonstrations(
        rows=torch.cat(rows[:count]),
        held_out=torch.cat(rows[count:]) if demos.held_out else None,
        content_hash=loaded.content_hash,
        source=loaded.source,
        saturated_share=loaded.saturated_share,
        success_share=success_share(loaded.episodes),
        simulator_steps=steps.taken,
        episodes=loaded.episodes[:count],
    )
