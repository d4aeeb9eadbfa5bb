"""SIGINT and SIGTERM: a run finishes its step or update and saves; a second one ends it at once."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
TOGETHER_S: Final = 0.25
GRACE_S: Final = 0.5
"""For the handler of a second signal, which lets the system end the process as it would."""


class Interrupted(BaseException):
    """A signal has ended this; no error, and nothing that catches errors may keep it.

    Args:
        signum: Which signal.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(signal.Signals(signum).name)
        self.exit_code = 128 + signum


class StopRequest:
    """Whether a run shall end as soon as it can go on from there."""

    def __init__(self) -> None:
        self.signum: int | None = None
        self._at_once = False

    def make(self, signum: int) -> None:
        """By a signal's handler.

        Raises:
            Interrupted: Within :meth:`at_once`.
        """
        self.signum = signum
        if self._at_once:
            raise Interrupted(signum)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """What is inside is done again when the run goes on: a request ends it wherever it is.

        Raises:
            Interrupted: If there is one, or as soon as there is.
        """
        self.leave()
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    @property
    def made(self) -> bool:
        """Whether there is one."""
        return self.signum is not None

    def leave(self) -> None:
        """Where nothing is lost by stopping: between two steps of an evaluation, for example.

        Raises:
            Interrupted: If there is one.
        """
        if self.signum is not None:
            raise Interrupted(self.signum)


class SignalCount:
    """How often somebody asked, which is less often than signals arrive.

    ``timeout`` and a cluster signal every process of a job, and make passes its own on: what comes
    within ``TOGETHER_S`` of the first is the same request.
    """

    def __init__(self) -> None:
        self._first: float | None = None

    def next(self) -> int:
        """Of the signal that came now: 1, 2 for any that asks again, 0 for a copy of the first."""
        now = time.monotonic()
        if self._first is None:
            self._first = now
            return 1
        return 2 if now - self._first >= TOGETHER_S else 0


class Interruption:
    """What the signals do: at first they end the program, then what a run does about them."""

    def __init__(self) -> None:
        self._request: StopRequest | None = None
        self._signals = SignalCount()

    def asks(self, request: StopRequest) -> None:
        """From now on the first signal is a request."""
        self._request = request

    def __call__(self, signum: int, _frame: FrameType | None) -> None:
        """Handles a signal."""
        number = self._signals.next()
        if number > 1:
            signal.signal(signum, signal.SIG_DFL)
            os.kill(os.getpid(), signum)
        if number != 1:
            return
        if self._request is None:
            raise Interrupted(signum)
        self._request.make(signum)


@contextmanager
def interruption() -> Iterator[Interruption]:
    """Handles the signals inside, in the main thread; the handlers of before come back."""
    handler = Interruption()
    before = {signum: signal.signal(signum, handler) for signum in SIGNALS}
    try:
        with _second_signal_ends_it():
            yield handler
    finally:
        for signum, was in before.items():
            signal.signal(signum, was)


@contextmanager
def _second_signal_ends_it() -> Iterator[None]:
    """Even while the main thread is in a simulator's or torch's own code, which hears of none.

    Python calls a handler once that code returns, and once for all signals of the meantime.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    _writers.add(writer)
    over = threading.Event()
    threading.Thread(target=_count, args=(reader, over), name="signals", daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        _writers.discard(writer)
        os.close(writer)


def _count(reader: int, over: threading.Event) -> None:
    """Ends the process ``GRACE_S`` after the second signal, unless it is ``over`` by then."""
    count = SignalCount()
    while signum := os.read(reader, 1):
        if signum[0] in SIGNALS and count.next() > 1 and not over.wait(GRACE_S):
            os._exit(128 + signum[0])
    os.close(reader)


def _not_in_children() -> None:
    """A child that a task forks would write its own copies of a terminal's signals to our pipe."""
    if _writers:
        signal.set_wakeup_fd(-1)


_writers: Final[set[int]] = set()
"""Ends of the pipes that signals are written to."""
os.register_at_fork(after_in_child=_not_in_children)
