"""SIGINT and SIGTERM: a run finishes its step or update and saves; a second one ends it at once."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
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


class Interruption:
    """What the signals do: at first they end the program, then what a run does about them."""

    def __init__(self) -> None:
        self._request: StopRequest | None = None
        self._signalled = False

    def asks(self, request: StopRequest) -> None:
        """From now on the first signal is a request."""
        self._request = request

    def __call__(self, signum: int, _frame: FrameType | None) -> None:
        """Handles a signal."""
        if self._signalled:
            signal.signal(signum, signal.SIG_DFL)
            os.kill(os.getpid(), signum)
            return
        self._signalled = True
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
    over = threading.Event()
    threading.Thread(target=_count, args=(reader, over), name="signals", daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        os.close(writer)


def _count(reader: int, over: threading.Event) -> None:
    """Ends the process ``GRACE_S`` after the second signal, unless it is ``over`` by then."""
    signals = 0
    while signum := os.read(reader, 1):
        signals += signum[0] in SIGNALS
        if signals > 1 and not over.wait(GRACE_S):
            os._exit(128 + signum[0])
    os.close(reader)
