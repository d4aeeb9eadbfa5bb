"""Where a run's wall time goes."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

from pipeline.files.run_files import RunDirectoryError, as_json, write_atomically

TIME_USE = "time_use.json"
WALL_S = "wall_s"
OTHER = "other"


class TimeUse:
    """Seconds per part of a run, each without the parts inside it, so that they sum to the whole.

    ``torchrl.timeit`` counts a nested part twice, once more in each part around it.
    On an accelerator a part's time is what its host waits for, not the device's own.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = 0.0

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Counts the time inside as ``name``; the part around it stands still meanwhile."""
        self._book()
        self._open.append(name)
        try:
            yield
        finally:
            self._book()
            self._open.pop()

    def watch(self, thing: Any, method: str, name: str) -> None:
        """Counts the calls of one object's method as ``name``, from now on."""
        setattr(thing, method, self.timed(getattr(thing, method), name))

    def timed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """``function``, counted as ``name``."""

        @wraps(function)
        def counted(*arguments: Any, **options: Any) -> Any:
            with self.part(name):
                return function(*arguments, **options)

        return counted

    @property
    def elapsed(self) -> float:
        """Seconds of all parts until now, those of the runs that a resumed one continues too."""
        self._book()
        return sum(self.seconds.values())

    def write(self, run_dir: Path) -> None:
        """Writes ``time_use.json``: the parts in seconds, longest first, and their sum."""
        parts = dict(sorted(self.seconds.items(), key=lambda part: -part[1]))
        report = {WALL_S: sum(parts.values()), "parts_s": parts}
        write_atomically(run_dir / TIME_USE, as_json(report, indent=2) + "\n")

    @staticmethod
    def read_wall_s(run_dir: Path) -> float | None:
        """Seconds in all that :meth:`write` wrote; None where there is no such file.

        Raises:
            RunDirectoryError: If it is damaged.
        """
        path = run_dir / TIME_USE
        if not path.is_file():
            return None
        try:
            return float(json.loads(path.read_text())[WALL_S])
        except (ValueError, KeyError, TypeError) as error:
            raise RunDirectoryError(f"{path} is damaged ({error}); restore or remove it") from error

    def state_dict(self) -> dict[str, float]:
        """Seconds so far: those of a resumed run go on."""
        return dict(self.seconds)

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Adds what :meth:`state_dict` gave to what this run has taken so far, its own setup."""
        for part, seconds in state.items():
            self.seconds[part] += seconds

    def reach(self, wall_s: float) -> None:
        """Counts what is missing to ``wall_s`` as spent, so that time goes on from there.

        A row may be younger than the checkpoint which a run goes on from, whose seconds end before
        it.
        """
        self.seconds[OTHER] += max(0.0, wall_s - self.elapsed)

    def _book(self) -> None:
        now = time.perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._since
        self._since = now
