"""What a hand task says of varying its demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs.adroit.guide import ArmGuide
from envs.adroit.hand import HandTask, Placement
from envs.demonstrations.episode import Episode
from envs.demonstrations.schema import DemoSchema

Follow = Callable[[Episode], Sequence[NDArray[np.float64]]]
"""How much of each offset the palm follows at each step of a source, [T] each."""


class Guided(NamedTuple):
    """How the palm is moved for another start.

    Attributes:
        guide: moves it.
        offsets: of a source's placement and another, [3] each, m: the ways that things have moved.
        follow: one [T] in [0, 1] for each of them.
    """

    guide: ArmGuide
    offsets: Callable[[Placement, Placement], Sequence[NDArray[np.float64]]]
    follow: Follow


@dataclass(frozen=True)
class Varying:
    """One task's part in varying demonstrations; the rest is the same for every hand.

    Attributes:
        name: with the settings of `HandVariation` part of a cache's key: change it whenever the
            rest of this gives other attempts.
        task: draws starts and plays.
        schema: of the episodes.
        apart: how far a start is from that of a source (in this order), in a unit of its own.
        apart_key: its name in an episode's provenance.
        scale_key: what `HandVariation.scale` is called, with its unit.
        progress: what ``min_progress`` is, for messages: ``a hinge angle in rad``.
        guided: how the palm is moved; None where no start asks for it.
        begins: step of a source by which something is under way; None if it never is.
        under_way: whether it is, bool [N], in observations [N, O] of copies with this placement,
            [N, k] by name. An attempt in which it is not, so late, is given up.
        patience: steps that an attempt may be later than its source.
    """

    name: str
    task: HandTask
    schema: DemoSchema
    apart: Callable[[Placement, Placement], float]
    apart_key: str
    scale_key: str
    progress: str
    guided: Guided | None
    begins: Callable[[Episode], int | None]
    under_way: Callable[[NDArray[np.float32], Placement], NDArray[np.bool_]]
    patience: int


def first(holds: NDArray[np.bool_]) -> int | None:
    """Number of the first entry of [T] that holds; None if none does."""
    found = np.flatnonzero(holds)
    return int(found[0]) if len(found) else None
