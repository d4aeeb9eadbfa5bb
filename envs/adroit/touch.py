"""Who touches what: what a task of the hand records of contacts, for telling its strategies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FORCES: Final = "contact_forces"
"""Column of an environment that records contacts: normal forces [N, P * K], N, by hand part and
target, in the order of `Contacts`."""
OPPOSITION: Final = "opposition"
"""Likewise [N, 1]: the cosine between what pushes the thumb and what pushes the rest of the hand,
on the targets that are held; -1 is a grasp from opposite sides, 0 also where one is missing."""


@dataclass(frozen=True)
class Contacts:
    """What an environment of a task records with `EnvOptions.strategies`.

    Attributes:
        parts: of the hand, in their order, P.
        thumb: the part that can oppose the others.
        targets: what can be touched, in their order, K.
        held: those of them by which a hand leads.
        begins: progress, from that of an episode's first step, at which the travel begins.
        moved: progress likewise, above which something was moved at all.
        words: what the classes of `envs.adroit.strategies` mean here.
    """

    parts: tuple[str, ...]
    thumb: str
    targets: tuple[str, ...]
    held: tuple[str, ...]
    begins: float
    moved: float
    words: Mapping[str, str]

    def __post_init__(self) -> None:
        strangers = {*self.held} - {*self.targets} or {self.thumb} - {*self.parts}
        if strangers:
            raise ValueError(f"{sorted(strangers)} is held or opposes, and cannot be touched")

    def touching(self, forces: NDArray[np.floating], above: float) -> str:
        """What touches what, for people: ``palm, thumb: handle; first: panel``.

        Args:
            forces: Normal forces [P * K], N, as in `FORCES`.
            above: Force from which on a part touches, N.
        """
        touched = np.reshape(forces, (len(self.parts), len(self.targets))) > above
        by_parts: dict[str, list[str]] = {}
        for target, on_target in zip(self.targets, touched.T, strict=True):
            parts = ", ".join(part for part, on in zip(self.parts, on_target, strict=True) if on)
            by_parts.setdefault(parts, []).append(target)
        by_parts.pop("", None)
        told = [f"{parts}: {', '.join(targets)}" for parts, targets in by_parts.items()]
        return "; ".join(told) or "no contact"
