"""Contestants in processes of their own, asked one after another for short timed blocks.

A machine shared with others, or one that changes its clock, is slower at one time than at
another. Rounds that visit every contestant spread such times over all of them, so that ratios of
medians hold where absolute times do not. Each contestant is set up once and sleeps between its
blocks, and none can disturb another's thread pool or allocator.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PROCESS = multiprocessing.get_context("spawn")


class Contestant(Protocol):
    """Something that can be timed."""

    units: float
    """Units of work (updates, frames, environment steps, floating point operations) of a call."""

    def call(self) -> None:
        """Does the work and returns when it is finished."""


@dataclass(frozen=True)
class Entry:
    """How to make a contestant, or what to run, in a process of its own."""

    name: str
    factory: str
    """``module:function``, resolved in the worker."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    threads: int = 1


@dataclass(frozen=True)
class Timing:
    """What the rounds gave for one contestant."""

    seconds_per_unit: list[float]
    peak_mib: float
    """Largest resident memory of its process so far."""


class WorkerError(RuntimeError):
    """A worker failed; the message names it and holds its traceback."""


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0))


def peak_resident_mib() -> float:
    """Largest resident memory of this process since it began, in MiB.

    Not ``getrusage``, whose maximum a new process inherits from the one that started it.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("the kernel reports no VmHWM; peak memory needs Linux")


def timed_block(contestant: Contestant, seconds: float) -> float:
    """Seconds per unit over calls that fill about ``seconds``; one call before them is not timed.

    The untimed call wakes the thread pool and brings the working set back into the caches, which
    other contestants have used meanwhile.
    """
    contestant.call()
    calls = 0
    began = time.perf_counter()
    elapsed = 0.0
    while elapsed < seconds:
        contestant.call()
        calls += 1
        elapsed = time.perf_counter() - began
    return elapsed / (calls * contestant.units)


def _child(connection: Connection, entry: Entry) -> None:
    """A worker's life: make the contestant, answer requests, end when the parent hangs up."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = str(entry.threads)
    # XLA has no thread count of its own: it makes a thread for each core it may use.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: entry.threads])
    warnings.simplefilter("ignore")  # other packages' deprecations are not this report's business
    os.environ["RL_LOGGING_LEVEL"] = "WARNING"  # torchrl reports each buffer it allocates
    try:
        module, _, function = entry.factory.partition(":")
        make: Callable[..., Any] = getattr(importlib.import_module(module), function)
        made = make(**entry.arguments)
        connection.send(("done", made if _is_plain(made) else None))
        while True:
            seconds = connection.recv()
            connection.send(("done", (timed_block(made, seconds), peak_resident_mib())))
    except EOFError:
        return
    except Exception:
        connection.send(("error", traceback.format_exc()))


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, (dict, list, float, int, str))


class Worker:
    """The parent's end of one worker process; use it in a ``with`` statement."""

    def __init__(self, entry: Entry) -> None:
        self.name = entry.name
        self._connection, theirs = PROCESS.Pipe()
        self._process = PROCESS.Process(target=_child, args=(theirs, entry), daemon=True)
        self._process.start()
        # Only the child may hold its end: else its death is not seen here.
        theirs.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._process.join(timeout=10)
        if self._process.is_alive():
            self._process.terminate()

    def receive(self) -> Any:
        """What the worker answers.

        Raises:
            WorkerError: If it failed or died.
        """
        try:
            kind, content = self._connection.recv()
        except EOFError as error:
            self._process.join(timeout=10)
            raise WorkerError(
                f"the worker of {self.name} died (exit code {self._process.exitcode}); "
                "-9 is usually the kernel short of memory"
            ) from error
        if kind == "error":
            raise WorkerError(f"the worker of {self.name} failed:\n{content}")
        return content

    def measure(self, seconds: float) -> tuple[float, float]:
        """Asks for one block: seconds per unit, and the peak memory in MiB."""
        self._connection.send(seconds)
        block: tuple[float, float] = self.receive()
        return block


def race(entries: Sequence[Entry], *, rounds: int, block_s: float) -> dict[str, Timing]:
    """Times contestants in turn.

    A block takes ``block_s`` seconds, or one call if that takes longer.

    Raises:
        WorkerError: If a contestant fails.
        ValueError: If two have the same name.
    """
    names = [entry.name for entry in entries]
    if len(set(names)) != len(names):
        raise ValueError(f"contestants need different names, got {names}")
    seconds: dict[str, list[float]] = {name: [] for name in names}
    peak: dict[str, float] = {}
    with ExitStack() as stack:
        workers = []
        for entry in entries:
            workers.append(stack.enter_context(Worker(entry)))
            # One after the other: what a contestant decides by measuring, it decides undisturbed.
            workers[-1].receive()
        for number in range(rounds):
            # Another one begins each round, so that none always follows the same neighbour.
            first = number % len(workers)
            for worker in workers[first:] + workers[:first]:
                per_unit, peak[worker.name] = worker.measure(block_s)
                seconds[worker.name].append(per_unit)
    return {name: Timing(seconds[name], peak[name]) for name in names}


def run_once(function: str, *, threads: int, **arguments: Any) -> Any:
    """Runs ``module:function`` in a fresh process and returns its (plain) result.

    Raises:
        WorkerError: If it fails.
    """
    with Worker(Entry(function, function, arguments, threads)) as worker:
        return worker.receive()
