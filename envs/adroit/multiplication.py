"""Plays variations of a hand's demonstrations in batches, and keeps those that succeed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.adroit.attempts import Attempt, AttemptFactory
from envs.adroit.replay import Replay, replay
from envs.adroit.simulator import HandSimulator
from envs.adroit.varying import Varying
from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.schema import DemoSchema


@dataclass(frozen=True)
class HandVariation:
    """How a hand task varies its demonstrations; see `envs.demonstrations.variation`.

    Attributes:
        varying: the task's part.
        scale: a source is chosen with weight exp(-(d / scale)^2), d being how far its start is from
            the new one, in the task's unit.
        guide_arm: move the palm along with what stands elsewhere, where the task says how.

    Raises:
        ValueError: the scale is not positive.
    """

    varying: Varying
    scale: float
    guide_arm: bool = True

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise ValueError(f"{self.varying.scale_key} must be positive, got {self.scale}")

    @property
    def schema(self) -> DemoSchema:
        """Of the episodes."""
        return self.varying.schema

    @property
    def identity(self) -> str:
        """The task's name for its part, and the settings of this class."""
        of = self.varying
        return f"{of.name}({of.scale_key}={self.scale}, guide_arm={self.guide_arm})"

    @contextmanager
    def open(
        self, episodes: Sequence[Episode], settings: MultiplyConfig, num_threads: int | None
    ) -> Iterator[Player]:
        """A simulator, and what is computed once of the sources.

        Raises:
            DemonstrationError: an episode does not say where things stand.
            ValueError: ``settings.min_progress`` is beyond all progress.
        """
        varying, goal, full = self.varying, settings.min_progress, self.schema.full_progress
        if goal is not None and full is not None and goal >= full:
            raise ValueError(
                f"demos.multiply.min_progress is {varying.progress} below {full}, got {goal}"
            )
        if not self.guide_arm:
            varying = dataclasses.replace(varying, guided=None)
        with HandSimulator(varying.task, settings.round_size, num_threads) as simulator:
            factory = AttemptFactory.prepare(
                episodes, settings, simulator.scene, varying, self.scale
            )
            yield Player(simulator, factory, tuple(episodes))


@dataclass(frozen=True)
class Player:
    """Draws attempts and plays them; see `envs.demonstrations.variation.Player`."""

    simulator: HandSimulator
    factory: AttemptFactory
    episodes: tuple[Episode, ...]

    def draw(
        self, index: int, weights: NDArray[np.float64], speeds: NDArray[np.float64] | None = None
    ) -> Attempt:
        """See `AttemptFactory.draw`."""
        return self.factory.draw(index, weights, speeds)

    def play(self, attempts: Sequence[Attempt]) -> Iterator[Episode | None]:
        """Plays attempts together; an episode for each that succeeds, in order."""
        settings, varying = self.factory.settings, self.factory.varying
        result = play_attempts(self.simulator, attempts, settings, varying)
        whole = result.steps == (settings.horizon or varying.task.horizon)
        kept = accomplished(result, settings) & (whole | ended(result, settings)) & ~result.diverged
        for i, attempt in enumerate(attempts):
            source = self.episodes[attempt.source].provenance
            yield _episode(source, attempt, result, i, varying.apart_key) if kept[i] else None


def play_attempts(
    simulator: HandSimulator,
    attempts: Sequence[Attempt],
    settings: MultiplyConfig,
    varying: Varying,
) -> Replay:
    """Simulate attempts together, in the first copies; the others are idle."""
    count, horizon = simulator.num_copies, settings.horizon or varying.task.horizon
    rows = [*range(len(attempts)), *[-1] * (count - len(attempts))]
    lengths = np.where(np.arange(count) < len(attempts), horizon, 0)
    actions = np.zeros((count, horizon, varying.task.action_size))
    actions[: len(attempts)] = [attempt.executed_actions for attempt in attempts]
    placement = {
        name: np.stack([attempt.placement[name] for attempt in attempts])[rows]
        for name in simulator.placement
    }
    deadline = np.array([attempt.under_way_by for attempt in attempts])[rows]

    def still_promising(steps: int, played: Replay) -> NDArray[np.bool_]:
        # Open-loop replays that miss their object never come back to it: stop paying for them.
        under_way = varying.under_way(played.observations[:, steps], placement)
        return ((steps <= deadline) | under_way) & ~ended(played, settings)

    return replay(simulator, actions, lengths, placement, keep_going=still_promising)


def accomplished(played: Replay, settings: MultiplyConfig) -> NDArray[np.bool_]:
    """Which attempts have done what is asked of those that are kept, [N]."""
    goal = settings.min_progress
    there = played.success if goal is None else played.progress > goal
    if settings.hold:
        return np.asarray(there[np.arange(len(there)), played.steps] & (played.steps > 0))
    return played.ever(there)


def ended(played: Replay, settings: MultiplyConfig) -> NDArray[np.bool_]:
    """Which of these have also come to where their readers end them, [N]."""
    if settings.end_progress is None:
        return np.zeros(len(played.steps), dtype=bool)
    return accomplished(played, settings) & played.ever(played.progress > settings.end_progress)


def _episode(
    origin: Provenance, attempt: Attempt, result: Replay, index: int, apart_key: str
) -> Episode:
    details = {
        "attempt": attempt.index,
        "speed": attempt.speed,
        "noise_scale": attempt.noise_scale,
        apart_key: attempt.apart,
    }
    steps = result.steps[index]
    clean = attempt.clean_actions[:steps]
    executed = attempt.executed_actions[:steps].clip(-1.0, 1.0)
    noisy = not np.array_equal(executed, clean)
    # Copies: a kept episode must not keep the arrays of its whole round.
    return Episode(
        observations=result.observations[index, : steps + 1].copy(),
        actions=clean.astype(np.float32),
        rewards=result.rewards[index, :steps].copy(),
        terminated=result.terminated[index, :steps].copy(),
        provenance=Provenance(origin.source, origin.episode, "multiplied", details),
        start=dict(attempt.placement),
        success=result.success[index, : steps + 1].copy(),
        progress=result.progress[index, : steps + 1].copy(),
        executed_actions=executed.astype(np.float32) if noisy else None,
    )
