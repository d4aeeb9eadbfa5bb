"""Models that differ from copy to copy: which numbers a change writes, kept for each copy."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

ModelChange = Callable[[mujoco.MjModel], None]
"""Writes into the numbers of a model in place; its sizes and names stay."""

_NOT_LOOKED_AT: Final = ("bvh_aabb",)
"""Made of the meshes, and larger than all the others together."""


class ModelChanges:
    """Finds the numbers that a change writes, by making it on a model of its own.

    Args:
        model: That changes begin with; it is copied.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        self._numbers = _numbers(self._model)
        self._as_built = {name: values.copy() for name, values in self._numbers.items()}

    def make(
        self,
        change: ModelChange | None,
        index: int,
        changed: dict[str, NDArray[np.float64]],
        num_copies: int,
    ) -> bool:
        """Write row ``index`` of ``changed``, [N, k] by name; whether it got new names.

        Args:
            change: None is none.
            index: Of the copy.
            changed: Of all copies; the others' rows are the model's where a name is new.
            num_copies: N.
        """
        if change is not None:
            change(self._model)
        names = len(changed)
        for name, values in self._numbers.items():
            was = self._as_built[name]
            if name not in changed and not np.array_equal(values, was):
                changed[name] = np.tile(was, (num_copies, 1))
            if name in changed:
                changed[name][index] = values
            if change is not None:
                values[:] = was
        return len(changed) > names


def _numbers(model: mujoco.MjModel) -> dict[str, NDArray[np.float64]]:
    """Flat views of all arrays of float64 of a model, by name."""
    found = {}
    for name in dir(model):
        if name.startswith("_") or name in _NOT_LOOKED_AT:
            continue
        values = getattr(model, name)
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            found[name] = values.reshape(-1)
    return found
