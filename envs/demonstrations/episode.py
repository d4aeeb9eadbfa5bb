"""What a demonstration is in this project: one whole episode and where it came from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["recorded", "resimulated", "multiplied", "policy"]
Detail = float | int | str | bool


@dataclass(frozen=True)
class Provenance:
    """Where an episode came from.

    Attributes:
        source: name of the source (a file name, ``minari:ID``, a run).
        episode: index of the episode within that source.
        kind: ``recorded`` as published, ``resimulated`` in our simulator, ``multiplied`` from
            another episode, or rolled out by a ``policy``.
        details: what is needed to make it again (speed, noise, seed, checkpoint, ...).
    """

    source: str
    episode: int
    kind: Kind
    details: Mapping[str, Detail] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))

    def __reduce__(self) -> tuple[object, ...]:
        # A mapping proxy cannot be pickled, and episodes travel between processes.
        return Provenance, (self.source, self.episode, self.kind, dict(self.details))

    def __str__(self) -> str:
        """Where to look for it, for messages."""
        return f"{self.source}, episode {self.episode}"


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T transitions; ``observations[t + 1]`` follows ``actions[t]``.

    Attributes:
        observations: float32 [T + 1, O], in the order of the task's environment.
        actions: float32 [T, A] as recorded; entries may lie outside [-1, 1] (environments clip).
        rewards: float32 [T], of the source's own reward until the episode is re-simulated.
        terminated: bool [T], true at the last step only, if at all.
        provenance: where the episode came from.
        start: where it begins, by the names of the task's schema (a door's position, joint angles,
            a seed); what the file does not hold is missing.
        success: bool [T + 1], whether the task is accomplished at each observation; None where
            nobody knows.
        progress: float32 [T + 1], how far it is, in the task's unit; None likewise.
        executed_actions: float32 [T, A], what led to the observations and rewards where that is
            not ``actions`` (DART: noise is executed, the clean action is there to be imitated);
            None where it is.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    provenance: Provenance
    start: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    success: NDArray[np.bool_] | None = None
    progress: NDArray[np.float32] | None = None
    executed_actions: NDArray[np.float32] | None = None

    def __repr__(self) -> str:
        return (
            f"Episode(length={self.length}, return={self.return_:.1f}, "
            f"max_progress={self.max_progress:.3f}, "
            f"{self.provenance.kind} from {self.provenance.source}[{self.provenance.episode}])"
        )

    @property
    def length(self) -> int:
        """Number of transitions, T."""
        return len(self.actions)

    @property
    def return_(self) -> float:
        """Undiscounted sum of all rewards."""
        return self.return_at(self.length)

    def return_at(self, horizon: int | None) -> float:
        """Undiscounted sum of the first ``horizon`` rewards (of all, if the episode is shorter)."""
        return float(self.rewards[:horizon].sum(dtype=np.float64))

    @property
    def played_actions(self) -> NDArray[np.float32]:
        """The actions [T, A] that led to the observations."""
        return self.actions if self.executed_actions is None else self.executed_actions

    @cached_property
    def max_progress(self) -> float:
        """Largest progress reached after an action, in the task's unit; NaN if nobody knows."""
        return float("nan") if self.progress is None else float(self.progress[1:].max())

    @cached_property
    def succeeds(self) -> bool | None:
        """Whether the task is accomplished after any action; None if nobody knows."""
        return None if self.success is None else bool(self.success[1:].any())

    @cached_property
    def clipped_entries(self) -> int:
        """Number of action entries outside [-1, 1]; environments clip these."""
        return int((np.abs(self.actions) > 1.0).sum())

    def first_steps(self, steps: int) -> Episode:
        """The episode's first ``steps`` transitions. The end is a cut, not a terminal state."""
        return Episode(
            observations=self.observations[: steps + 1],
            actions=self.actions[:steps],
            rewards=self.rewards[:steps],
            terminated=self.terminated[:steps],
            provenance=self.provenance,
            start=self.start,
            success=None if self.success is None else self.success[: steps + 1],
            progress=None if self.progress is None else self.progress[: steps + 1],
            executed_actions=(
                None if self.executed_actions is None else self.executed_actions[:steps]
            ),
        )


def content_hash(episodes: Iterable[Episode]) -> str:
    """SHA-256 (hex) over everything in the episodes: arrays and provenance, in order."""
    digest = hashlib.sha256()
    for episode in episodes:
        p = episode.provenance
        digest.update(repr((p.source, p.episode, p.kind, sorted(p.details.items()))).encode())
        named: dict[str, NDArray[np.generic] | None] = {
            "observations": episode.observations,
            "actions": episode.actions,
            "rewards": episode.rewards,
            "terminated": episode.terminated,
            "success": episode.success,
            "progress": episode.progress,
            "executed_actions": episode.executed_actions,
        }
        named |= {f"start/{key}": episode.start[key] for key in sorted(episode.start)}
        for name, array in named.items():
            if array is not None:
                # Shape and dtype are hashed too: equal bytes of another shape are another array.
                digest.update(repr((name, array.shape, array.dtype.str)).encode())
                digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
