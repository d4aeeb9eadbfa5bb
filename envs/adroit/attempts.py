"""Variations of a hand's demonstrations, drawn one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import Placement
from envs.adroit.scene import HandScene
from envs.adroit.variation import correlated_noise, retime, servo_compliance
from envs.adroit.varying import Guided, Varying
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig


@dataclass(frozen=True, eq=False)
class Attempt:
    """One variation of one source.

    Attributes:
        index: number of the attempt; with the seed it fixes all random draws.
        source: index of the source episode.
        placement: where things stand, [k] by name.
        apart: how far that is from the source's placement.
        speed: relative to the recording.
        noise_scale: standard deviation of the noise, in half-ranges of the joints.
        clean_actions: [H, A] in [-1, 1], what is recorded.
        executed_actions: [H, A], clean actions plus noise.
        under_way_by: step from which the attempt is given up unless it is under way, in 0..H.
    """

    index: int
    source: int
    placement: Placement
    apart: float
    speed: float
    noise_scale: float
    clean_actions: NDArray[np.float64]
    executed_actions: NDArray[np.float64]
    under_way_by: int


@dataclass(frozen=True, eq=False)
class _Template:
    actions: NDArray[np.float64]
    placement: Placement
    action_per_metre: tuple[NDArray[np.float64], ...]
    begins: int | None


@dataclass(frozen=True, eq=False)
class AttemptFactory:
    """Draws attempts; everything that depends only on the sources is computed once."""

    varying: Varying
    templates: tuple[_Template, ...]
    compliance: NDArray[np.float64]
    settings: MultiplyConfig
    scale: float

    @classmethod
    def prepare(
        cls,
        episodes: Sequence[Episode],
        settings: MultiplyConfig,
        scene: HandScene,
        varying: Varying,
        scale: float,
    ) -> AttemptFactory:
        """Build the factory.

        Args:
            episodes: the sources.
            settings: how to vary them.
            scene: the task's; its model is read only.
            varying: the task's part.
            scale: a source is chosen with weight exp(-(apart / scale)^2).

        Raises:
            DemonstrationError: an episode does not say where things stand.
        """
        templates = tuple(_template(episode, scene, varying) for episode in episodes)
        return cls(varying, templates, servo_compliance(scene), settings, scale)

    def draw(
        self, index: int, weights: NDArray[np.float64], speeds: NDArray[np.float64] | None = None
    ) -> Attempt:
        """Attempt number ``index``, the same for the same index, seed and weights.

        Args:
            index: number of the attempt.
            weights: [sources], not negative; multiplied by the nearness of each source's start.
            speeds: [sources, parts], not negative, of equal parts of the range of speeds; None is
                alike.
        """
        settings, varying = self.settings, self.varying
        horizon = settings.horizon or varying.task.horizon
        # A stream of its own per attempt: batches and threads cannot change what is drawn.
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
        placement = varying.task.draw(rng)
        pace = rng.uniform()
        noise_scale = float(rng.uniform(0.0, settings.noise_scale))
        apart = np.array([varying.apart(one.placement, placement) for one in self.templates])
        source = choose(rng, apart, weights, self.scale)
        template = self.templates[source]
        if speeds is not None:
            pace = share_below(pace, speeds[source])
        speed = float(settings.speed_low + (settings.speed_high - settings.speed_low) * pace)

        actions = template.actions
        if varying.guided is not None:
            actions = actions.copy()
            offsets = varying.guided.offsets(template.placement, placement)
            for per_metre, offset in zip(template.action_per_metre, offsets, strict=True):
                actions[:, varying.guided.guide.arm] += per_metre @ offset
        clean = retime(actions.clip(-1.0, 1.0), speed, horizon)
        noise = correlated_noise(rng, clean.shape, noise_scale, settings.noise_correlation)
        under_way_by = horizon
        if template.begins is not None:
            under_way_by = min(horizon, int(template.begins / speed) + varying.patience)
        return Attempt(
            index=index,
            source=source,
            placement=placement,
            apart=float(apart[source]),
            speed=speed,
            noise_scale=noise_scale,
            clean_actions=clean,
            # The arm moves 2.5 times as far as its target: unscaled, it would miss everything.
            executed_actions=clean + self.compliance * noise,
            under_way_by=under_way_by,
        )


def _template(episode: Episode, scene: HandScene, varying: Varying) -> _Template:
    missing = sorted(scene.placed.keys() - episode.start.keys())
    if missing:
        raise DemonstrationError(
            episode.provenance,
            f"has no {' and no '.join(name.replace('_', ' ') for name in missing)}, which "
            "multiplication needs",
            "Store it in the file; what a task can infer, replaying does (demos.resimulate=true)",
        )
    return _Template(
        actions=episode.actions.astype(np.float64).clip(-1.0, 1.0),
        placement={name: episode.start[name] for name in scene.placed},
        action_per_metre=_action_per_metre(episode, scene, varying.guided),
        begins=varying.begins(episode),
    )


def _action_per_metre(
    episode: Episode, scene: HandScene, guided: Guided | None
) -> tuple[NDArray[np.float64], ...]:
    if guided is None:
        return ()
    before = episode.observations[:-1]
    shares = guided.follow(episode)
    return tuple(guided.guide.action_per_metre(scene, before, share) for share in shares)


def share_below(pace: float, weights: NDArray[np.float64]) -> float:
    """Turns a uniform number in [0, 1) into one that lies in equal parts of it as often as wanted.

    Args:
        pace: a uniform draw.
        weights: [parts], not negative and not all zero.
    """
    bounds = np.linspace(0.0, 1.0, len(weights) + 1)
    below = np.concatenate([[0.0], np.cumsum(weights / weights.sum())])
    return float(np.interp(pace, below, bounds))


def choose(
    rng: np.random.Generator,
    apart: NDArray[np.float64],
    weights: NDArray[np.float64],
    scale: float,
) -> int:
    """Choose a source: with probability proportional to weight times exp(-(apart / scale)^2).

    Args:
        rng: source of randomness.
        apart: [sources], how far each is from what is wanted.
        weights: [sources], not negative; where all are zero, the nearness alone counts.
        scale: in the unit of ``apart``.
    """
    # Logarithms, because far from every source all factors exp(-(d / scale)^2) underflow to zero.
    with np.errstate(divide="ignore"):
        scores = np.log(weights) - (apart / scale) ** 2
    if not np.isfinite(scores).any():
        scores = -((apart / scale) ** 2)
    probabilities = np.exp(scores - scores.max())
    return int(rng.choice(len(apart), p=probabilities / probabilities.sum()))
