"""The one gate that every episode passes, whatever file it came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.matrices import action_matrix, numbers, observation_matrix
from envs.demonstrations.schema import DemoSchema


@dataclass(frozen=True)
class RawEpisode:
    """The arrays of one episode as a file holds them, before any check.

    Attributes:
        observations: [T, ...] (the last next-observation is missing) or [T + 1, ...], or several of
            these by name, mappings in mappings too.
        actions: [T, ...].
        rewards: [T], or None to compute them with the task's reward.
        terminated: [T], or None where the file does not say.
        start: vectors of the schema's ``start`` that the file holds, by their names in the schema.
        success: after every action [T], or at every observation [T + 1]; None where nobody knows.
        progress: at every observation [T + 1], or None.
        executed_actions: [T, A], what was executed where that is not ``actions``, or None.
        normalised: the actions are in [-1, 1] already, whatever units the schema names for files.
    """

    observations: ArrayLike | Mapping[str, Any]
    actions: ArrayLike
    rewards: ArrayLike | None = None
    terminated: ArrayLike | None = None
    start: Mapping[str, ArrayLike] = field(default_factory=dict)
    success: ArrayLike | None = None
    progress: ArrayLike | None = None
    executed_actions: ArrayLike | None = None
    normalised: bool = False


def build_episode(
    raw: RawEpisode,
    provenance: Provenance,
    where: str,
    schema: DemoSchema,
    notes: Notes | None = None,
) -> Episode:
    """Check one raw episode against the task's schema and bring it into the project's form.

    Observations become one vector per step (`envs.demonstrations.flattening`) and lose the columns
    that only the schema's other widths have. Actions are rescaled to [-1, 1]. Where the file has as
    many observations as actions, the observation after the last action was never stored, so the
    last action is dropped. The episode ends at the first observation that is terminal in the task.

    Args:
        raw: the arrays as the file holds them.
        provenance: goes into the episode unchanged.
        where: file and episode, for the error messages.
        schema: of the task.
        notes: take down what has been dropped or changed.

    Returns:
        The validated episode. Its rewards are NaN where neither the file nor the schema has any:
        re-simulation may still tell them (`envs.demonstrations.loading` refuses what is left).

    Raises:
        DemonstrationError: wrong shape or dtype, NaN, infinity or what float32 cannot hold, actions
            beyond the schema's bound, or fewer than two observations.
    """
    notes = Notes() if notes is None else notes
    observations = observation_matrix(raw.observations, where, schema, notes)
    actions = action_matrix(raw.actions, where, schema, normalised=raw.normalised)
    executed = _executed(raw, len(actions), where, schema)
    steps = _transition_count(len(observations), len(actions), where)
    notes.add(Kind.LAST_ACTION, len(actions) - steps, where)

    terminated = _terminated(raw, observations, len(actions), steps, where, schema)
    if terminated.any():
        # Nothing after a terminal observation is a transition of this task.
        kept = int(terminated.argmax()) + 1
        notes.add(Kind.AFTER_END, steps - kept, where)
        steps = kept
    observations = observations[: steps + 1]
    notes.add(Kind.CLIPPED, int((np.abs(actions[:steps]) > 1.0).sum()), where)
    return Episode(
        observations=observations,
        actions=actions[:steps].astype(np.float32),
        rewards=_rewards(raw, observations, len(actions), where, schema, notes)[:steps],
        terminated=terminated[:steps],
        provenance=provenance,
        start={
            key.name: _vector(raw.start[key.name], key.name, key.size, where)
            for key in schema.start
            if key.name in raw.start
        },
        success=_success(raw, observations, len(actions), where, schema, notes),
        progress=_progress(raw, observations, len(actions), where, schema, notes),
        executed_actions=None if executed is None else executed[:steps],
    )


def reward_agreement(episode: Episode, schema: DemoSchema) -> float:
    """Share of steps whose recorded reward is the task's, within the schema's tolerance.

    NaN where the task has no reward to compare with.
    """
    if schema.reward is None:
        return float("nan")
    ours = np.asarray(schema.reward(episode.observations[1:]), dtype=np.float64)
    return float(np.mean(np.abs(ours - episode.rewards) <= schema.reward_tolerance))


def require_keys(
    mapping: Mapping[str, object], keys: tuple[str, ...], where: str, remedy: str
) -> None:
    """Raise `DemonstrationError` that names the keys of ``keys`` which ``mapping`` lacks."""
    missing = [key for key in keys if key not in mapping]
    if missing:
        found = ", ".join(sorted(map(str, mapping))) or "nothing"
        raise DemonstrationError(where, f"lacks {', '.join(missing)} (found: {found})", remedy)


def found_start(state: Mapping[str, ArrayLike], schema: DemoSchema) -> dict[str, ArrayLike]:
    """The vectors of the schema's ``start`` that ``state`` holds under any of their names."""
    named = {key.name: next((n for n in key.names if n in state), None) for key in schema.start}
    return {name: state[found] for name, found in named.items() if found is not None}


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


def _executed(
    raw: RawEpisode, actions: int, where: str, schema: DemoSchema
) -> NDArray[np.float32] | None:
    if raw.executed_actions is None:
        return None
    executed = action_matrix(raw.executed_actions, where, schema, normalised=raw.normalised)
    if len(executed) != actions:
        raise DemonstrationError(
            where,
            f"has {len(executed)} executed_actions for {actions} actions",
            "Store one executed action per action, or none at all",
        )
    return executed.astype(np.float32)


def _terminated(
    raw: RawEpisode,
    observations: NDArray[np.float32],
    actions: int,
    steps: int,
    where: str,
    schema: DemoSchema,
) -> NDArray[np.bool_]:
    if schema.terminated is not None:
        return np.asarray(schema.terminated(observations[1 : steps + 1]), dtype=np.bool_)
    if raw.terminated is None:
        return np.zeros(steps, dtype=np.bool_)
    return _column(raw.terminated, "terminated", (actions,), where)[:steps].astype(np.bool_)


def _rewards(
    raw: RawEpisode,
    observations: NDArray[np.float32],
    actions: int,
    where: str,
    schema: DemoSchema,
    notes: Notes,
) -> NDArray[np.float32]:
    if raw.rewards is not None:
        return _column(raw.rewards, "rewards", (actions,), where).astype(np.float32)
    notes.add(Kind.NO_REWARDS, 1, where)
    if schema.reward is not None:
        return np.asarray(schema.reward(observations[1:]), dtype=np.float32)
    return np.full(len(observations) - 1, np.nan, dtype=np.float32)


def _success(
    raw: RawEpisode,
    observations: NDArray[np.float32],
    actions: int,
    where: str,
    schema: DemoSchema,
    notes: Notes,
) -> NDArray[np.bool_] | None:
    if schema.success is not None:
        return np.asarray(schema.success(observations), dtype=np.bool_)
    if raw.success is None:
        return None
    found = _column(raw.success, "success", None, where).astype(np.bool_)
    if len(found) == actions:
        # One flag after each action says nothing of the beginning, which is no success.
        found = np.concatenate([[False], found])
    if len(found) != actions + 1:
        notes.add(Kind.UNALIGNED, 1, f"{where}, success [{len(found)}] for {actions} actions")
        return None
    return found[: len(observations)]


def _progress(
    raw: RawEpisode,
    observations: NDArray[np.float32],
    actions: int,
    where: str,
    schema: DemoSchema,
    notes: Notes,
) -> NDArray[np.float32] | None:
    if schema.progress is not None:
        return np.asarray(schema.progress(observations), dtype=np.float32)
    if raw.progress is None:
        return None
    found = _column(raw.progress, "progress", None, where).astype(np.float32)
    if len(found) != actions + 1:
        notes.add(Kind.UNALIGNED, 1, f"{where}, progress [{len(found)}] for {actions} actions")
        return None
    return found[: len(observations)]


def _column(
    value: ArrayLike, name: str, sizes: tuple[int, ...] | None, where: str
) -> NDArray[np.float64]:
    column = numbers(value, name, where)
    if column.ndim == 2 and column.shape[1] == 1:
        column = column[:, 0]
    if column.ndim != 1 or (sizes is not None and len(column) not in sizes):
        expected = "" if sizes is None else f", expected {' or '.join(f'[{n}]' for n in sizes)}"
        raise DemonstrationError(
            where, f"{name} has shape {list(column.shape)}{expected}", "Store one per action"
        )
    return column


def _vector(value: ArrayLike, name: str, size: int, where: str) -> NDArray[np.float64]:
    vector = numbers(value, name, where, single=False)
    if vector.shape != (size,):
        raise DemonstrationError(
            where, f"{name} has shape {list(vector.shape)}, expected [{size}]", "Repair the file"
        )
    return vector
