"""Copies of an environment, counted against the free memory before they are made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import psutil

T = TypeVar("T")
MIB: Final = 2**20


def require_memory(name: str, make: Callable[[], T], count: int, *, sharers: int = 1) -> list[T]:
    """Makes ``count`` copies if there is room for them.

    What a copy takes is how much the process grows with the second one: the first brings in
    modules and files that all copies share.

    Args:
        name: of the task, for messages.
        make: makes one.
        count: how many.
        sharers: processes that do the same at the same time.

    Raises:
        ValueError: there is no room for all of them.
    """
    process = psutil.Process()
    made = [make()]
    while len(made) < count:
        before = process.memory_info().rss
        made.append(make())
        if len(made) != 2:
            continue
        each = process.memory_info().rss - before
        free = psutil.virtual_memory().available // sharers
        if each * (count - 2) > free:
            raise ValueError(
                f"{count} copies of {name} need {each * count / MIB:,.0f} MiB, {each / MIB:,.0f} "
                f"each, and {free / MIB:,.0f} MiB are free: step fewer together (env.num_envs, "
                "evaluation.batch)"
            )
    return made
