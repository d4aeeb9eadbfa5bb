"""Copies of an environment in processes of their own, each with a part of them."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.util
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.sharedctypes import RawArray
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.library.copies import Buffers, Copies, Layout
from envs.task import TaskFailedError

Array = NDArray[Any]
# A process with threads (torch's) must not be forked; the server has none, and imports once what
# takes long. (Not this package: Python 3.11's server does not have its parent's path.)
PROCESSES: Final[ForkServerContext] = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["torchrl.envs", "mujoco"])
PATIENCE_S: Final = 5.0
"""How long all workers together may take to end: their step, and closing their copies."""


class Workers:
    """N copies in ``workers`` processes that write into shared memory.

    Args:
        make: makes one copy; it is sent to the workers.
        count: N.
        layout: what they write.
        workers: processes, at most N.

    Raises:
        ValueError: the copies do not fit into the free memory.
    """

    def __init__(
        self,
        make: Callable[[], gymnasium.Env[Any, Any]],
        count: int,
        layout: Layout,
        workers: int,
    ) -> None:
        self.layout = layout
        shared: dict[str, Any] = {}
        self.buffers = Buffers.make(count, layout, lambda *of: _allocate(shared, *of))
        edges = np.linspace(0, count, workers + 1).astype(int).tolist()
        self.parts = [slice(a, b) for a, b in pairwise(edges)]
        self.connections: list[Connection] = []
        self.processes: list[ForkServerProcess] = []
        # Should nobody close them. Python's own way is SIGTERM, which they leave to the parent.
        self._end = multiprocessing.util.Finalize(None, _kill, (self.processes,), exitpriority=1)
        for part in self.parts:
            ours, theirs = PROCESSES.Pipe()
            process = PROCESSES.Process(
                target=_work,
                args=(theirs, make, list(shared.values()), count, part, layout, workers),
                daemon=True,
            )
            process.start()
            # Only the worker may hold its end: else its death is not seen here.
            theirs.close()
            self.connections.append(ours)
            self.processes.append(process)
        self._answers(range(workers))

    def reset(self, copies: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin new episodes in some copies.

        Raises:
            TaskFailedError: an environment raised, or a worker died.
        """
        chosen, numbers = np.asarray(copies), np.asarray(seeds)
        asked = {}
        for k, part in enumerate(self.parts):
            ours = (chosen >= part.start) & (chosen < part.stop)
            if ours.any():
                asked[k] = ("reset", (chosen[ours] - part.start).tolist(), numbers[ours].tolist())
        self._ask(asked)

    def step(self, copies: Sequence[int]) -> None:
        """One step of some copies, with the actions in the buffers.

        Raises:
            TaskFailedError: an environment raised, or a worker died.
        """
        chosen = np.asarray(copies)
        asked = {}
        for k, part in enumerate(self.parts):
            ours = chosen[(chosen >= part.start) & (chosen < part.stop)]
            if len(ours):
                asked[k] = ("step", (ours - part.start).tolist())
        self._ask(asked)

    def place(self, copy: int, put: Callable[[gymnasium.Env[Any, Any]], Any]) -> None:
        """Have ``put``, which is sent, change a copy's state; it returns the observation then."""
        k = next(k for k, part in enumerate(self.parts) if copy < part.stop)
        self._ask({k: ("place", copy - self.parts[k].start, put)})

    def get_state(self) -> dict[str, Array]:
        """The whole state of all copies, stacked."""
        states = self._ask(dict.fromkeys(range(len(self.parts)), ("get_state",)))
        return {key: np.concatenate([state[key] for state in states]) for key in states[0]}

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._ask({
            k: ("set_state", {key: values[part] for key, values in state.items()})
            for k, part in enumerate(self.parts)
        })  # fmt: skip

    def close(self) -> None:
        """Close all copies and end the processes."""
        for connection in self.connections:
            connection.close()
        until = time.monotonic() + PATIENCE_S
        for process in self.processes:
            process.join(max(0.0, until - time.monotonic()))
        self._end()

    def _ask(self, asked: Mapping[int, tuple[Any, ...]]) -> list[Any]:
        for k, request in asked.items():
            try:
                self.connections[k].send(request)
            except OSError as error:
                raise self._dead(k) from error
        return self._answers(asked)

    def _answers(self, workers: Any) -> list[Any]:
        answers = []
        failed = None
        # All of them: an answer that is left lying would be taken for that to the next question.
        for k in workers:
            try:
                answer = self.connections[k].recv()
            except (EOFError, OSError) as error:
                raise self._dead(k) from error
            if isinstance(answer, Exception):
                failed = failed or answer
            answers.append(answer)
        if failed is not None:
            raise failed
        return answers

    def _dead(self, k: int) -> TaskFailedError:
        self.processes[k].join(PATIENCE_S)
        part = self.parts[k]
        return TaskFailedError(
            f"task {self.layout.name}: the process of copies {part.start} to {part.stop - 1} died "
            f"(exit code {self.processes[k].exitcode}); env.workers=0 runs them in this one"
        )


def _kill(processes: Sequence[ForkServerProcess]) -> None:
    for process in processes:
        if process.is_alive():
            process.kill()


def _allocate(shared: dict[str, Any], shape: tuple[int, ...], dtype: Any) -> Array:
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = RawArray("b", max(size, 1))
    shared[str(len(shared))] = memory
    return _view(memory, shape, dtype)


def _view(memory: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    count = int(np.prod(shape))
    return np.frombuffer(memory, dtype=dtype, count=count).reshape(shape)


def _work(
    connection: Connection,
    make: Callable[[], gymnasium.Env[Any, Any]],
    shared: list[Any],
    count: int,
    part: slice,
    layout: Layout,
    sharers: int,
) -> None:
    """A worker's life: make its copies, do what is asked, end when the parent hangs up."""
    # Ctrl-C goes to every process of the terminal, and a cluster's SIGTERM to every one of a job;
    # what is done about it is the parent's business.
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, signal.SIG_IGN)
    memories = iter(shared)
    buffers = Buffers.make(count, layout, lambda *of: _view(next(memories), *of))
    try:
        copies = Copies(make, buffers.part(part), layout, first=part.start, sharers=sharers)
    except Exception as error:  # it is raised again in the parent
        connection.send(error)
        return
    connection.send(None)
    try:
        while True:
            request, *arguments = connection.recv()
            try:
                connection.send(getattr(copies, request)(*arguments))
            except (TaskFailedError, ValueError) as error:
                connection.send(error)
    except (EOFError, ConnectionError):  # it hung up before a question, or before its answer
        # Nobody is left to tell that one raised.
        with contextlib.suppress(TaskFailedError):
            copies.close()
