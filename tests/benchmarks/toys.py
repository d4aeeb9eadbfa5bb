"""Contestants of known cost for the workers to run."""

from __future__ import annotations

import os
import time


class Sleeper:
    """A call of two units that takes a given time."""

    units = 2.0

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def call(self) -> None:
        time.sleep(self.seconds)


class Broken:
    units = 1.0

    def call(self) -> None:
        raise ArithmeticError("seven is not even")


class Dying:
    units = 1.0

    def call(self) -> None:
        os._exit(3)


def surroundings(greeting: str) -> dict[str, str | int]:
    return {
        "greeting": greeting,
        "omp": os.environ["OMP_NUM_THREADS"],
        "cores": len(os.sched_getaffinity(0)),
    }
