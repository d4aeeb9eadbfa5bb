"""What one task adds to the hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs.adroit.contacts import Surface
from envs.adroit.physics import HandStates
from envs.adroit.scene import HandScene
from envs.adroit.touch import Contacts

Placement = Mapping[str, NDArray[np.float64]]
"""Where things stand, by the names of `HandScene.placed`."""


class Judged(NamedTuple):
    """What a task says of N copies now, each of shape [N]."""

    reward: NDArray[np.float32]
    success: NDArray[np.bool_]
    progress: NDArray[np.floating]
    terminated: NDArray[np.bool_]


@dataclass(frozen=True)
class HandTask:
    """One task of the hand.

    Attributes:
        copies: What its copies are called in messages: ``doors``.
        observation_size: Entries of an observation.
        action_size: Entries of an action, each in [-1, 1]: normalised joint position targets.
        horizon: Control steps after which an episode is truncated.
        scene: Compiles its model.
        observe: Observations [N, O], float32, of states.
        judge: Rewards and flags, of states and their observations.
        draw: Where things stand at the start of an episode.
        contacts: What is recorded of contacts on request; None where nothing can be.
        surfaces: What can be touched there.
    """

    copies: str
    observation_size: int
    action_size: int
    horizon: int
    scene: Callable[[], HandScene]
    observe: Callable[[HandStates], NDArray[np.float32]]
    judge: Callable[[HandStates, NDArray[np.float32]], Judged]
    draw: Callable[[np.random.Generator], Placement]
    contacts: Contacts | None = None
    surfaces: tuple[Surface, ...] = ()
