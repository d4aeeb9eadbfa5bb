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

from envs.door import task

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


@dataclass(frozen=True, eq=False)
class Episode:
    """One door episode of T transitions; ``observations[t + 1]`` follows ``actions[t]``.

    Attributes:
        observations: float32 [T + 1, 38], in the order of `envs.door.task`.
        actions: float32 [T, 28] as recorded; entries may lie outside [-1, 1] (the simulator clips).
        rewards: float32 [T], of the source's own reward until the episode is re-simulated.
        terminated: bool [T], true at the last step only, if at all.
        provenance: where the episode came from.
        door_position: float64 [3], position of the door frame in metres, or None if unknown.
        initial_qpos: float64 [30] joint positions (rad, m) before the first action, or None.
        initial_qvel: float64 [30] joint velocities before the first action, or None.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    provenance: Provenance
    door_position: NDArray[np.float64] | None = None
    initial_qpos: NDArray[np.float64] | None = None
    initial_qvel: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        origin = f"{self.provenance.source}[{self.provenance.episode}]"
        return (
            f"Episode(length={self.length}, return={self.return_:.1f}, "
            f"max_angle={self.max_angle:.3f}, {self.provenance.kind} from {origin})"
        )

    @property
    def length(self) -> int:
        """Number of transitions, T."""
        return len(self.actions)

    @property
    def return_(self) -> float:
        """Undiscounted sum of all rewards."""
        return self.return_at(self.length)

    def return_at(self, horizon: int) -> float:
        """Undiscounted sum of the first ``horizon`` rewards (of all, if the episode is shorter)."""
        return float(self.rewards[:horizon].sum(dtype=np.float64))

    @cached_property
    def max_angle(self) -> float:
        """Largest hinge angle reached after an action, in rad."""
        return float(task.hinge_angle(self.observations[1:]).max())

    @cached_property
    def clipped_entries(self) -> int:
        """Number of action entries outside [-1, 1]; the simulator clips these."""
        return int((np.abs(self.actions) > 1.0).sum())


def content_hash(episodes: Iterable[Episode]) -> str:
    """SHA-256 (hex) over everything in the episodes: arrays and provenance, in order."""
    digest = hashlib.sha256()
    for episode in episodes:
        p = episode.provenance
        digest.update(repr((p.source, p.episode, p.kind, sorted(p.details.items()))).encode())
        for array in (
            episode.observations,
            episode.actions,
            episode.rewards,
            episode.terminated,
            episode.door_position,
            episode.initial_qpos,
            episode.initial_qvel,
        ):
            if array is None:
                digest.update(b"none")
            else:
                # Shape and dtype are hashed too: equal bytes of another shape are another array.
                digest.update(repr((array.shape, array.dtype.str)).encode())
                digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
