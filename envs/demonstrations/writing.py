"""What a writer of demonstrations is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from envs.demonstrations.episode import Episode
from envs.demonstrations.schema import DemoSchema

Write = Callable[[str, Sequence[Episode], Mapping[str, Any], DemoSchema | None], None]
"""Writes at least one episode, the card that tells how they were made, and, where the schema has
them, actions in the units that others use."""


@dataclass(frozen=True)
class Writer:
    """One format; a module of `envs.demonstrations.writers` with a ``WRITER`` is found by itself.

    Attributes:
        form: how its outputs are named, for messages.
        fits: whether a name means this format.
        write: writes it.
        ready: raises if what it needs for a name is not installed; asked before episodes are made.
    """

    form: str
    fits: Callable[[str], bool]
    write: Write
    ready: Callable[[str], object] = str
