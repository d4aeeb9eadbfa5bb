"""SIGINT and SIGTERM: a run finishes its update and saves; a second signal stops it at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


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
        self._request.signum = signum


@contextmanager
def interruption() -> Iterator[Interruption]:
    """Handles the signals inside, in the main thread; the handlers of before come back."""
    handler = Interruption()
    before = {signum: signal.signal(signum, handler) for signum in SIGNALS}
    try:
        yield handler
    finally:
        for signum, was in before.items():
            signal.signal(signum, was)
