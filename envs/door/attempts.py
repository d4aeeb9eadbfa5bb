"""Variations of a door's demonstrations: drawn one by one, played in batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.adroit.replay import replay
from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.schema import DemoSchema
from envs.door import task
from envs.door.demos import DOOR_POSITION, SCHEMA
from envs.door.scene import DoorScene
from envs.door.simulator import DoorSimulator
from envs.door.variation import (
    ARM,
    ArmGuide,
    correlated_noise,
    retime,
    servo_compliance,
)

#: An attempt whose door is still closed so many steps after it should have moved is given up.
_PATIENCE = 30


@dataclass(frozen=True, eq=False)
class Attempt:
    """One variation of one source.

    Attributes:
        index: number of the attempt; with the seed it fixes all random draws.
        source: index of the source episode.
        door_position: [3] in metres.
        door_offset: distance in metres to the source's door.
        speed: relative to the recording.
        noise_scale: standard deviation of the noise, in half-ranges of the joints.
        clean_actions: [H, 28] in [-1, 1], what is recorded.
        executed_actions: [H, 28], clean actions plus noise.
        opens_by: step by which the door should have moved, in 0..H.
    """

    index: int
    source: int
    door_position: NDArray[np.float64]
    door_offset: float
    speed: float
    noise_scale: float
    clean_actions: NDArray[np.float64]
    executed_actions: NDArray[np.float64]
    opens_by: int


@dataclass(frozen=True, eq=False)
class _Template:
    actions: NDArray[np.float64]
    door_position: NDArray[np.float64]
    action_per_metre: NDArray[np.float64] | None
    opening_step: int | None


@dataclass(frozen=True, eq=False)
class AttemptFactory:
    """Draws attempts; everything that depends only on the sources is computed once."""

    templates: tuple[_Template, ...]
    compliance: NDArray[np.float64]
    settings: MultiplyConfig
    position_scale_m: float

    @classmethod
    def prepare(
        cls,
        episodes: Sequence[Episode],
        settings: MultiplyConfig,
        scene: DoorScene,
        vary: DoorVariation,
    ) -> AttemptFactory:
        """Build the factory.

        Raises:
            DemonstrationError: an episode has no door position.
        """
        guide = ArmGuide(scene) if vary.guide_arm else None
        templates = tuple(_template(episode, guide) for episode in episodes)
        return cls(templates, servo_compliance(scene), settings, vary.position_scale_m)

    def draw(self, index: int, weights: NDArray[np.float64]) -> Attempt:
        """Attempt number ``index``, the same for the same index, seed and weights.

        Args:
            index: number of the attempt.
            weights: [sources], not negative; multiplied by the nearness of each source's door.
        """
        settings = self.settings
        horizon = settings.horizon or task.HORIZON
        # A stream of its own per attempt: batches and threads cannot change what is drawn.
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
        door = rng.uniform(task.DOOR_POSITION_LOW, task.DOOR_POSITION_HIGH)
        speed = float(rng.uniform(settings.speed_low, settings.speed_high))
        noise_scale = float(rng.uniform(0.0, settings.noise_scale))
        offsets = door - np.stack([template.door_position for template in self.templates])
        source = _choose(rng, np.linalg.norm(offsets, axis=1), weights, self.position_scale_m)
        template, offset = self.templates[source], offsets[source]

        actions = template.actions
        if template.action_per_metre is not None:
            actions = actions.copy()
            actions[:, ARM] += template.action_per_metre @ offset
        clean = retime(actions.clip(-1.0, 1.0), speed, horizon)
        noise = correlated_noise(rng, len(clean), noise_scale, settings.noise_correlation)
        opens_by = horizon
        if template.opening_step is not None:
            opens_by = min(opens_by, int(template.opening_step / speed) + _PATIENCE)
        return Attempt(
            index=index,
            source=source,
            door_position=door,
            door_offset=float(np.linalg.norm(offset)),
            speed=speed,
            noise_scale=noise_scale,
            clean_actions=clean,
            # The arm moves 2.5 times as far as its target: unscaled, it would miss the handle.
            executed_actions=clean + self.compliance * noise,
            opens_by=opens_by,
        )


@dataclass(frozen=True)
class DoorVariation:
    """How the door varies its demonstrations; see `envs.demonstrations.multiplication.Variation`.

    Attributes:
        position_scale_m: a source is chosen with weight exp(-(d / scale)^2), d being the distance
            in metres between its door and the new one.
        guide_arm: shift the palm's path by the offset between the two doors (`ArmGuide`).

    Raises:
        ValueError: the scale is not positive.
    """

    position_scale_m: float = 0.08
    guide_arm: bool = True

    def __post_init__(self) -> None:
        if not self.position_scale_m > 0:
            raise ValueError(f"position_scale_m must be positive, got {self.position_scale_m}")

    @property
    def schema(self) -> DemoSchema:
        """Of the episodes."""
        return SCHEMA

    @property
    def identity(self) -> str:
        """Settings of this class."""
        return repr(self)

    @contextmanager
    def open(
        self, episodes: Sequence[Episode], settings: MultiplyConfig, num_threads: int | None
    ) -> Iterator[_Player]:
        """A simulator, and what is computed once of the sources.

        Raises:
            DemonstrationError: an episode has no door position.
            ValueError: ``settings.min_progress`` is an angle that no door reaches.
        """
        if settings.min_progress is not None and settings.min_progress >= task.FULLY_OPEN:
            raise ValueError(
                f"demos.multiply.min_progress is a hinge angle in rad below {task.FULLY_OPEN}, "
                f"got {settings.min_progress}"
            )
        with DoorSimulator(settings.round_size, num_threads=num_threads) as simulator:
            factory = AttemptFactory.prepare(episodes, settings, simulator.scene, self)
            yield _Player(simulator, factory, tuple(episodes))


@dataclass(frozen=True)
class _Player:
    simulator: DoorSimulator
    factory: AttemptFactory
    episodes: tuple[Episode, ...]

    def draw(self, index: int, weights: NDArray[np.float64]) -> Attempt:
        return self.factory.draw(index, weights)

    def play(self, attempts: Sequence[Attempt]) -> Iterator[Episode | None]:
        settings = self.factory.settings
        for attempt, seen in play_attempts(self.simulator, attempts, settings):
            source = self.episodes[attempt.source].provenance
            yield None if seen is None else _episode(source, attempt, seen)


def play_attempts(
    simulator: DoorSimulator, attempts: Sequence[Attempt], settings: MultiplyConfig
) -> Iterator[tuple[Attempt, NDArray[np.float32] | None]]:
    """Simulate attempts together.

    Yields:
        Each attempt in order, with its observations [T + 1, 38] if it succeeded, else None.
    """
    horizon = settings.horizon or task.HORIZON
    goal = task.SUCCESS_ANGLE if settings.min_progress is None else settings.min_progress
    spare = simulator.num_doors - len(attempts)
    actions = np.zeros((simulator.num_doors, horizon, task.ACTION_SIZE))
    actions[: len(attempts)] = [attempt.executed_actions for attempt in attempts]
    doors = np.stack([attempt.door_position for attempt in attempts])
    deadline = np.pad([attempt.opens_by for attempt in attempts], (0, spare))

    def still_promising(t: int, observations: NDArray[np.float32]) -> NDArray[np.bool_]:
        # Open-loop replays that miss the handle never come back to it: stop paying for them.
        return (t < deadline) | (task.hinge_angle(observations) > task.OPEN_THRESHOLDS[0])

    result = replay(
        simulator,
        actions,
        np.where(np.arange(simulator.num_doors) < len(attempts), horizon, 0),
        {DOOR_POSITION: np.pad(doors, ((0, spare), (0, 0)), mode="edge")},
        keep_going=still_promising,
    )
    for i, attempt in enumerate(attempts):
        steps = int(result.steps[i])
        observations = result.observations[i, : steps + 1]
        complete = steps == horizon and not result.diverged[i]
        success = complete and task.hinge_angle(observations).max() > goal
        yield attempt, observations.copy() if success else None


def _episode(origin: Provenance, attempt: Attempt, observations: NDArray[np.float32]) -> Episode:
    details = {
        "attempt": attempt.index,
        "speed": attempt.speed,
        "noise_scale": attempt.noise_scale,
        "door_offset_m": attempt.door_offset,
    }
    steps = len(observations) - 1
    executed = attempt.executed_actions.clip(-1.0, 1.0)
    noisy = not np.array_equal(executed, attempt.clean_actions)
    return Episode(
        observations=observations,
        actions=attempt.clean_actions[:steps].astype(np.float32),
        rewards=task.reward(observations[1:]),
        terminated=task.terminated(observations[1:]),
        provenance=Provenance(origin.source, origin.episode, "multiplied", details),
        start={DOOR_POSITION: attempt.door_position},
        success=task.success(observations),
        progress=task.hinge_angle(observations),
        executed_actions=executed[:steps].astype(np.float32) if noisy else None,
    )


def _template(episode: Episode, guide: ArmGuide | None) -> _Template:
    if DOOR_POSITION not in episode.start:
        raise DemonstrationError(
            episode.provenance,
            "has no door position, which multiplication needs",
            "Re-simulate the demonstrations first (it infers the position)",
        )
    moved = np.flatnonzero(task.hinge_angle(episode.observations[1:]) > task.OPEN_THRESHOLDS[0])
    return _Template(
        actions=episode.actions.astype(np.float64).clip(-1.0, 1.0),
        door_position=episode.start[DOOR_POSITION],
        action_per_metre=(
            None if guide is None else guide.action_per_metre(episode.observations[:-1])
        ),
        opening_step=int(moved[0]) if len(moved) else None,
    )


def _choose(
    rng: np.random.Generator,
    distances: NDArray[np.float64],
    weights: NDArray[np.float64],
    scale: float,
) -> int:
    # Logarithms, because far from every source all factors exp(-(d / scale)^2) underflow to zero.
    with np.errstate(divide="ignore"):
        scores = np.log(weights) - (distances / scale) ** 2
    if not np.isfinite(scores).any():
        scores = -((distances / scale) ** 2)
    probabilities = np.exp(scores - scores.max())
    return int(rng.choice(len(distances), p=probabilities / probabilities.sum()))
