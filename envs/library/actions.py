"""Actions in an environment's own units and in [-1, 1]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.scaling import from_unit


class UnsupportedActionsError(ValueError):
    """The actions are not a finite box of numbers; the message says what is wrong, and where."""


@dataclass(frozen=True, eq=False)
class ActionScale:
    """Maps a flat vector in [-1, 1] to an action of the environment (files: `envs.scaling`).

    Attributes:
        low: least action, float64 [A], C order of the environment's shape.
        high: largest action, likewise.
        shape: of an action of the environment.
        dtype: of it.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, space: gymnasium.Space[Any]) -> Self:
        """The scale of a box.

        Raises:
            UnsupportedActionsError: ``space`` is no box, is empty, or an entry's range is infinite
                or a single number.
        """
        if not isinstance(space, spaces.Box):
            raise UnsupportedActionsError(
                f"its actions are {space}, and policies here take finite boxes of numbers: "
                "choose or wrap an environment whose actions are continuous (task.wrappers)"
            )
        low, high = (np.asarray(b, np.float64).reshape(-1) for b in (space.low, space.high))
        if low.size == 0:
            raise UnsupportedActionsError(f"its actions are empty: {space}")
        for i, (least, most) in enumerate(zip(low, high, strict=True)):
            if not (np.isfinite(least) and np.isfinite(most) and least < most):
                entry = ",".join(map(str, np.unravel_index(i, space.shape)))
                kind = "infinite" if least < most else "a single number"
                raise UnsupportedActionsError(
                    f"the range of action entry [{entry}] is {kind}: [{least}, {most}], and it is "
                    "needed to rescale [-1, 1]: give it bounds, or leave it out, in a wrapper "
                    "(gymnasium.wrappers.RescaleAction, task.wrappers)"
                )
        return cls(low, high, space.shape, space.dtype)

    @property
    def size(self) -> int:
        """A, entries of an action."""
        return len(self.low)

    def to_environment(self, unit: NDArray[np.floating]) -> NDArray[Any]:
        """Actions [..., A], clipped to [-1, 1], in the environment's units [..., *shape].

        Integers are rounded to the nearest.
        """
        actions = from_unit(np.clip(unit, -1.0, 1.0), self.low, self.high)
        if np.issubdtype(self.dtype, np.integer):
            actions = np.rint(actions)
        return actions.astype(self.dtype).reshape(*unit.shape[:-1], *self.shape)
