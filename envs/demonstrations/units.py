"""Whether a file's actions, taken in the task's units, look as if they were normalised."""

from __future__ import annotations

from typing import Final

import numpy as np

from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.matrices import ROUNDING
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

WIDE: Final = 4.0
"""Of the range of an action entry: twice that of [-1, 1]."""


class Units:
    """Sees the episodes of one file that passed; a remark is all that comes of it.

    Args:
        schema: of the task.
    """

    def __init__(self, schema: DemoSchema) -> None:
        bounds = zip(schema.action_low or (), schema.action_high or (), strict=True)
        self._low, self._high = max(bounds, key=lambda pair: pair[1] - pair[0], default=(-1.0, 1.0))
        self._largest: float | None = None

    def see(self, raw: RawEpisode) -> None:
        """Remember how far the actions of an episode reach; recordings of ours say their units."""
        if not raw.normalised:
            reach = float(np.abs(np.asarray(raw.actions, dtype=np.float64)).max())
            self._largest = max(self._largest or 0.0, reach)

    def tell(self, notes: Notes, name: str, refused: int) -> None:
        """Take the remark down, if there is one, for the file ``name``.

        Nothing is said of a file with refused episodes: their actions were not seen.
        """
        narrow = self._largest is not None and self._largest <= 1.0 + ROUNDING
        if refused or not narrow or self._high - self._low < WIDE:
            return
        remark = (
            f"{name}: all actions lie within [-1, 1], and the task's within [{self._low:g}, "
            f"{self._high:g}]: if they were normalised, multiply them back first"
        )
        notes.add(Kind.IN_UNIT_BOX, 1, remark)
