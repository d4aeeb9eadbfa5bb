"""Simulator steps that are taken beside training: by replays, variations and rollouts.

Frames alone hide them: multiplying 25 demonstrations of the door takes several times the control
steps of the training that follows. Whoever plays episodes says how many steps it took, and whoever
wants to know opens a count around it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass
class StepCount:
    """Control steps, summed over copies of the environment."""

    taken: int = 0


_OPEN: ContextVar[tuple[StepCount, ...]] = ContextVar("open step counts", default=())


@contextmanager
def counted_steps() -> Iterator[StepCount]:
    """Counts what :func:`count_steps` is told inside; counts may lie within one another."""
    count = StepCount()
    token = _OPEN.set((*_OPEN.get(), count))
    try:
        yield count
    finally:
        _OPEN.reset(token)


def count_steps(steps: int) -> None:
    """Says that so many control steps were taken; every open count grows by them.

    Raises:
        ValueError: ``steps`` is negative.
    """
    if steps < 0:
        raise ValueError(f"steps must not be negative, got {steps}")
    for count in _OPEN.get():
        count.taken += steps
