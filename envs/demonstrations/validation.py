"""The one gate that every episode passes, whatever file it came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.door import task

#: DAPG and D4RL/Minari append a door_open flag to the 38 entries of the task; it is dropped.
FLAGGED_OBSERVATION_SIZE = task.OBSERVATION_SIZE + 1
#: Positions and velocities of the hand (28), the door hinge and the latch.
STATE_SIZE = 30
#: The published human actions reach 1.37. Far beyond that the actions cannot be this task's
#: normalised position targets: they are raw joint angles, torques, or another scaling.
ACTION_BOUND = 3.0
#: The published rewards hold a velocity penalty that no observation shows; it stays below this.
REWARD_TOLERANCE = 0.05


@dataclass(frozen=True)
class RawEpisode:
    """The arrays of one episode as a file holds them, before any check.

    Attributes:
        observations: [T, 38 or 39] (the last next-observation is missing) or [T + 1, 38 or 39].
        actions: [T, 28].
        rewards: [T], or None to compute them with the task's reward.
        door_position: [3] in metres, or None; then it is inferred from the first observation.
        qpos: [30] before the first action, or None.
        qvel: [30] before the first action, or None.
    """

    observations: ArrayLike
    actions: ArrayLike
    rewards: ArrayLike | None = None
    door_position: ArrayLike | None = None
    qpos: ArrayLike | None = None
    qvel: ArrayLike | None = None


def build_episode(raw: RawEpisode, provenance: Provenance, where: str) -> Episode:
    """Check one raw episode and bring it into the project's form.

    Observations of 39 entries lose the last one. Where the file has as many observations as actions
    the observation after the last action was never stored, so the last action is dropped. The
    episode ends at the first observation that is terminal in our task (|palm - handle| > 1 m).

    Args:
        raw: the arrays as the file holds them.
        provenance: goes into the episode unchanged.
        where: file and episode, for the error messages.

    Returns:
        The validated episode.

    Raises:
        DemonstrationError: wrong shape or dtype, NaN or infinity, actions beyond `ACTION_BOUND`,
            or fewer than two observations.
    """
    observations = _matrix(
        raw.observations, "observations", where, (task.OBSERVATION_SIZE, FLAGGED_OBSERVATION_SIZE)
    )[:, : task.OBSERVATION_SIZE].astype(np.float32)
    actions = _matrix(raw.actions, "actions", where, (task.ACTION_SIZE,))
    steps = _transition_count(len(observations), len(actions), where)
    _check_action_range(actions, where)

    terminated = task.terminated(observations[1 : steps + 1])
    if terminated.any():
        # Nothing after a terminal observation is a transition of this task.
        steps = int(terminated.argmax()) + 1
    observations = observations[: steps + 1]
    if raw.rewards is None:
        rewards = task.reward(observations[1:]).astype(np.float64)
    else:
        rewards = _rewards(raw.rewards, len(actions), where)[:steps]
    return Episode(
        observations=observations,
        actions=actions[:steps].astype(np.float32),
        rewards=np.asarray(rewards, dtype=np.float32),
        terminated=np.asarray(terminated[:steps], dtype=np.bool_),
        provenance=provenance,
        door_position=_optional_vector(raw.door_position, "door position", 3, where),
        initial_qpos=_optional_vector(raw.qpos, "qpos", STATE_SIZE, where),
        initial_qvel=_optional_vector(raw.qvel, "qvel", STATE_SIZE, where),
    )


def reward_agreement(episode: Episode) -> float:
    """Share of steps whose recorded reward is within `REWARD_TOLERANCE` of the task's reward."""
    ours = task.reward(episode.observations[1:])
    return float(np.mean(np.abs(ours - episode.rewards) <= REWARD_TOLERANCE))


def require_keys(
    mapping: Mapping[str, object], keys: tuple[str, ...], where: str, remedy: str
) -> None:
    """Raise `DemonstrationError` that names the keys of ``keys`` which ``mapping`` lacks."""
    missing = [key for key in keys if key not in mapping]
    if missing:
        found = ", ".join(sorted(map(str, mapping))) or "nothing"
        raise DemonstrationError(where, f"lacks {', '.join(missing)} (found: {found})", remedy)


def _numbers(value: ArrayLike, name: str, where: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise DemonstrationError(
            where, f"{name} is ragged ({error})", "Store one rectangular array per episode"
        ) from error
    if array.dtype.kind not in "fiub":
        raise DemonstrationError(
            where, f"{name} has dtype {array.dtype}", "Store real numbers, e.g. float32"
        )
    result = array.astype(np.float64)
    if not np.isfinite(result).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(result))[0])
        raise DemonstrationError(
            where,
            f"{name}{list(index)} is {result[index]}",
            "Remove or repair this episode: NaN and infinity poison every later update",
        )
    return result


def _matrix(
    value: ArrayLike, name: str, where: str, widths: tuple[int, ...]
) -> NDArray[np.float64]:
    array = _numbers(value, name, where)
    if array.ndim != 2 or array.shape[1] not in widths:
        expected = " or ".join(f"[T, {width}]" for width in widths)
        raise DemonstrationError(
            where,
            f"{name} has shape {list(array.shape)}, expected {expected}",
            "Only demonstrations of the Adroit door (38-d or 39-d observations, 28-d actions) fit",
        )
    return array


def _transition_count(observations: int, actions: int, where: str) -> int:
    if observations - actions not in (0, 1):
        raise DemonstrationError(
            where,
            f"has {observations} observations for {actions} actions",
            "An episode holds as many observations as actions, or one more (the final one)",
        )
    if observations < 2 or actions < 1:
        raise DemonstrationError(
            where, f"has {observations} observations", "An episode needs at least one transition"
        )
    return observations - 1


def _check_action_range(actions: NDArray[np.float64], where: str) -> None:
    largest = float(np.abs(actions).max())
    if largest > ACTION_BOUND:
        raise DemonstrationError(
            where,
            f"has an action entry of magnitude {largest:.3g}, beyond {ACTION_BOUND}",
            "Actions must be normalised position targets in [-1, 1] (slight excess is clipped)",
        )


def _rewards(value: ArrayLike, steps: int, where: str) -> NDArray[np.float64]:
    rewards = _numbers(value, "rewards", where)
    if rewards.shape == (steps, 1):
        rewards = rewards[:, 0]
    if rewards.shape != (steps,):
        raise DemonstrationError(
            where,
            f"rewards has shape {list(rewards.shape)}, expected [{steps}]",
            "Store one reward per action",
        )
    return rewards


def _optional_vector(
    value: ArrayLike | None, name: str, size: int, where: str
) -> NDArray[np.float64] | None:
    if value is None:
        return None
    vector = _numbers(value, name, where)
    if vector.shape != (size,):
        raise DemonstrationError(
            where, f"{name} has shape {list(vector.shape)}, expected [{size}]", "Repair the file"
        )
    return vector
