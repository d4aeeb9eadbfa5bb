"""How alike a policy's movements are to the demonstrations': paths, postures, speed, smoothness.

A movement ends where the task is first accomplished, else at its largest progress, else with its
episode: what a hand does afterwards has no purpose to be alike in. Dynamic time warping takes speed
out of a comparison and jerk grows with its cube, so all three are told. The demonstrations
themselves are measured in the same way, each against the others: what a policy cannot be expected
to be nearer than.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from dtaidistance import dtw, dtw_ndim
from numpy.typing import NDArray
from torchrl.modules import ProbabilisticActor

from envs import Task
from envs.demonstrations import DemonstrationError, DemoOptions, Episode, load_demonstrations
from envs.motion import Motion
from losses.imitation_errors import clamp_to_support, negative_log_likelihood
from losses.policy import policy_distribution
from pipeline.act.metrics import Rollouts
from pipeline.act.recorder import Recorder

Floats = NDArray[np.float64]
QUANTILES = (0.1, 0.5, 0.9)
AT_BOUND = 0.99
"""Of an action entry's size, from which on it counts as saturated."""
LEAST_STEPS = 3
"""Of a movement, below which it has no jerk."""


@dataclass(frozen=True)
class Movement:
    """An episode up to its purpose.

    Attributes:
        path: of the end effector, from where the target stood at the start, [T + 1, 3], m.
        posture: [T + 1, J], rad.
        actions: [T, A] in [-1, 1].
    """

    path: Floats
    posture: Floats
    actions: Floats

    @classmethod
    def of(
        cls,
        motion: Motion,
        observations: NDArray[Any],
        actions: NDArray[Any],
        success: NDArray[np.bool_] | None,
        progress: NDArray[Any] | None,
    ) -> Self:
        """The movement of an episode.

        Args:
            motion: Of its task.
            observations: [T + 1, O].
            actions: [T, A].
            success: After each step, [T]; None where nobody tells.
            progress: Likewise.
        """
        steps = len(actions)
        if success is not None and success.any():
            steps = int(success.argmax()) + 1
        elif progress is not None:
            steps = int(progress.argmax()) + 1
        seen = observations[: steps + 1].astype(np.float64)
        return cls(
            path=motion.effector(seen) - motion.target(seen[0]),
            posture=np.asarray(motion.posture(seen), dtype=np.float64),
            actions=np.clip(actions[:steps].astype(np.float64), -1.0, 1.0),
        )


def warped_distance(a: Floats, b: Floats) -> float:
    """Mean Euclidean distance of two curves [N, D] and [M, D] along their warping path.

    Dynamic time warping with steps of weight 1; symmetric.
    """
    distance, costs = dtw_ndim.warping_paths_fast(
        np.ascontiguousarray(a), np.ascontiguousarray(b), inner_dist="euclidean"
    )
    return float(distance) / len(dtw.best_path(costs))


def smoothness(path: Floats, steps_per_second: float) -> dict[str, float]:
    """Speed and jerk of a path [T + 1, 3] in m.

    Returns:
        ``speed_mean`` and ``speed_peak`` (m/s), ``jerk_mean`` (m/s^3), and
        ``log_dimensionless_jerk``, -ln(duration^3 / peak speed^2 * integral of jerk^2): greater is
        smoother, whatever the speed (Balasubramanian et al. 2015). NaN where a path is too short,
        or does not move.
    """
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) * steps_per_second
    found = dict.fromkeys(
        ("speed_mean", "speed_peak", "jerk_mean", "log_dimensionless_jerk"), math.nan
    )
    if len(speed) < LEAST_STEPS or speed.max() == 0.0:
        return found
    jerk = np.linalg.norm(np.diff(path, n=3, axis=0), axis=1) * steps_per_second**3
    duration = len(speed) / steps_per_second
    integral = float(np.square(jerk).sum()) / steps_per_second
    scaled = integral * duration**3 / speed.max() ** 2
    return {
        "speed_mean": float(speed.mean()),
        "speed_peak": float(speed.max()),
        "jerk_mean": float(jerk.mean()),
        "log_dimensionless_jerk": -math.log(scaled) if scaled > 0.0 else math.nan,
    }


def likeness(
    movements: Sequence[Movement], shown: Sequence[Movement], steps_per_second: float
) -> dict[str, Any]:
    """Figures of movements beside those of demonstrations; quantiles over each (10, 50, 90 %).

    Args:
        movements: Of a policy.
        shown: Of the demonstrations.
        steps_per_second: Control steps in a second.

    Returns:
        ``path_distance`` (m) and ``posture_distance`` (rad, root mean square over joints) to the
        nearest demonstration, see :func:`warped_distance`; ``steps``, ``saturated_actions`` (share
        of entries) and :func:`smoothness`; and the same ``of_demonstrations``, each to the nearest
        of the others.
    """
    own = [_figures(m, shown, steps_per_second) for m in movements]
    theirs = [
        _figures(m, [*shown[:i], *shown[i + 1 :]], steps_per_second) for i, m in enumerate(shown)
    ]
    return {
        "episodes": len(movements),
        "demonstrations": len(shown),
        **_quantiles(own),
        "of_demonstrations": _quantiles(theirs),
    }


@dataclass(frozen=True)
class Comparison:
    """Compares the first episodes of an evaluation to demonstrations.

    Attributes:
        source: of the demonstrations.
        motion: of the task.
        demonstrations: as they are compared.
        recorder: what the evaluation has to show its steps to.
    """

    source: str
    motion: Motion
    demonstrations: tuple[Episode, ...]
    recorder: Recorder

    @classmethod
    def to(cls, source: str, task: Task, episodes: int) -> Self:
        """Reads the demonstrations, before anything is played.

        They are replayed in the task where it can: in the states that a policy would see.

        Args:
            source: Of the demonstrations.
            task: Theirs and the policy's.
            episodes: To compare at most.

        Raises:
            MissingCapabilityError: If the task does not say where its moving parts stand.
            DemonstrationError: If the demonstrations cannot be used.
        """
        motion: Motion = task.require("motion", f"make eval DEMOS={source}")
        return cls(source, motion, tuple(_demonstrations(task, source)), Recorder(episodes))

    def figures(
        self, rollouts: Rollouts, actor: ProbabilisticActor | None, margin: float
    ) -> dict[str, Any]:
        """See :func:`likeness`, of the episodes that were recorded, and :func:`mean_nll`.

        Args:
            rollouts: Of the evaluation.
            actor: Of one action at a time; None for others, which leaves out the likelihood.
            margin: As :func:`mean_nll`.
        """
        movements = []
        # The last wave may have played more episodes than were asked for.
        recorded = self.recorder.episodes()[: len(rollouts.lengths)]
        for i, (observations, actions) in enumerate(recorded):
            success = None if rollouts.success is None else rollouts.success[i, : len(actions)]
            progress = None if rollouts.progress is None else rollouts.progress[i, : len(actions)]
            movements.append(Movement.of(self.motion, observations, actions, success, progress))
        shown = [_shown(self.motion, episode) for episode in self.demonstrations]
        found = likeness(movements, shown, self.motion.steps_per_second)
        nll = None if actor is None else mean_nll(actor, self.demonstrations, margin)
        return {"to": Path(self.source).name, "demonstrations_nll": nll, **found}


def mean_nll(actor: ProbabilisticActor, episodes: Sequence[Episode], margin: float) -> float:
    """Mean of -log pi(a|s) over all steps of episodes, in nats an action (paper, section III-B).

    Args:
        actor: Of one action at a time.
        episodes: Of demonstrations.
        margin: Their actions are kept this far inside (-1, 1).
    """
    device = next(actor.parameters()).device
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    with torch.no_grad():
        policy = policy_distribution(actor, torch.as_tensor(observations, device=device))
        kept = clamp_to_support(torch.as_tensor(actions, device=device), margin)
        return float(negative_log_likelihood(policy, kept).mean())


def _demonstrations(task: Task, source: str) -> Sequence[Episode]:
    options = DemoOptions(resimulate=task.resimulate is not None)
    episodes = load_demonstrations(source, task, options).episodes
    if len(episodes) < 2:
        raise DemonstrationError(
            source, "holds one episode", "Likeness needs two, to compare them with one another"
        )
    return episodes


def _shown(motion: Motion, episode: Episode) -> Movement:
    success = None if episode.success is None else episode.success[1:]
    progress = None if episode.progress is None else episode.progress[1:]
    return Movement.of(motion, episode.observations, episode.actions, success, progress)


def _figures(movement: Movement, others: Sequence[Movement], rate: float) -> dict[str, float]:
    scale = math.sqrt(movement.posture.shape[1])
    return {
        "path_distance": min(warped_distance(movement.path, o.path) for o in others),
        "posture_distance": min(warped_distance(movement.posture, o.posture) for o in others)
        / scale,
        "steps": float(len(movement.actions)),
        "saturated_actions": float((np.abs(movement.actions) >= AT_BOUND).mean()),
        **smoothness(movement.path, rate),
    }


def _quantiles(figures: Sequence[Mapping[str, float]]) -> dict[str, list[float] | None]:
    found: dict[str, list[float] | None] = {}
    for key in figures[0]:
        values = np.array([of_one[key] for of_one in figures])
        known = values[np.isfinite(values)]
        found[key] = np.quantile(known, QUANTILES).tolist() if known.size else None
    return found
