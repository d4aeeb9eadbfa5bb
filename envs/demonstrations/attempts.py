"""The single attempts of demonstration multiplication: drawn one by one, played in batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.replay import replay
from envs.demonstrations.variation import (
    ARM,
    ArmGuide,
    correlated_noise,
    retime,
    servo_compliance,
)
from envs.door import task
from envs.door.scene import DoorScene
from envs.door.simulator import DoorSimulator

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

    @classmethod
    def prepare(
        cls, episodes: Sequence[Episode], settings: MultiplyConfig, scene: DoorScene
    ) -> AttemptFactory:
        """Build the factory.

        Raises:
            DemonstrationError: an episode has no door position.
        """
        guide = ArmGuide(scene) if settings.guide_arm else None
        templates = tuple(_template(episode, guide) for episode in episodes)
        return cls(templates, servo_compliance(scene), settings)

    def draw(self, index: int, weights: NDArray[np.float64]) -> Attempt:
        """Attempt number ``index``, the same for the same index, seed and weights.

        Args:
            index: number of the attempt.
            weights: [sources], not negative; multiplied by the nearness of each source's door.
        """
        settings = self.settings
        # A stream of its own per attempt: batches and threads cannot change what is drawn.
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
        door = rng.uniform(task.DOOR_POSITION_LOW, task.DOOR_POSITION_HIGH)
        speed = float(rng.uniform(settings.speed_low, settings.speed_high))
        noise_scale = float(rng.uniform(0.0, settings.noise_scale))
        offsets = door - np.stack([template.door_position for template in self.templates])
        source = _choose(rng, np.linalg.norm(offsets, axis=1), weights, settings.position_scale_m)
        template, offset = self.templates[source], offsets[source]

        actions = template.actions
        if template.action_per_metre is not None:
            actions = actions.copy()
            actions[:, ARM] += template.action_per_metre @ offset
        clean = retime(actions.clip(-1.0, 1.0), speed, settings.horizon)
        noise = correlated_noise(rng, len(clean), noise_scale, settings.noise_correlation)
        opens_by = settings.horizon
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


def play_attempts(
    simulator: DoorSimulator, attempts: Sequence[Attempt], settings: MultiplyConfig
) -> Iterator[tuple[Attempt, NDArray[np.float32] | None]]:
    """Simulate attempts together.

    Yields:
        Each attempt in order, with its observations [T + 1, 38] if it succeeded, else None.
    """
    spare = simulator.num_doors - len(attempts)
    actions = np.zeros((simulator.num_doors, settings.horizon, task.ACTION_SIZE))
    actions[: len(attempts)] = [attempt.executed_actions for attempt in attempts]
    doors = np.stack([attempt.door_position for attempt in attempts])
    deadline = np.pad([attempt.opens_by for attempt in attempts], (0, spare))

    def still_promising(t: int, observations: NDArray[np.float32]) -> NDArray[np.bool_]:
        # Open-loop replays that miss the handle never come back to it: stop paying for them.
        return (t < deadline) | (task.hinge_angle(observations) > task.OPEN_THRESHOLDS[0])

    result = replay(
        simulator,
        actions,
        np.where(np.arange(simulator.num_doors) < len(attempts), settings.horizon, 0),
        np.pad(doors, ((0, spare), (0, 0)), mode="edge"),
        keep_going=still_promising,
    )
    for i, attempt in enumerate(attempts):
        steps = int(result.steps[i])
        observations = result.observations[i, : steps + 1]
        complete = steps == settings.horizon and not result.diverged[i]
        success = complete and task.hinge_angle(observations).max() > settings.min_angle
        yield attempt, observations.copy() if success else None


def _template(episode: Episode, guide: ArmGuide | None) -> _Template:
    if episode.door_position is None:
        raise DemonstrationError(
            f"{episode.provenance.source}, episode {episode.provenance.episode}",
            "has no door position, which multiplication needs",
            "Re-simulate the demonstrations first (it infers the position)",
        )
    moved = np.flatnonzero(task.hinge_angle(episode.observations[1:]) > task.OPEN_THRESHOLDS[0])
    return _Template(
        actions=episode.actions.astype(np.float64).clip(-1.0, 1.0),
        door_position=episode.door_position,
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
