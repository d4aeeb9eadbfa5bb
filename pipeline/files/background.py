"""What a checkpoint still waits for when its files are written, done beside the training."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial

_logger = logging.getLogger(__name__)


class BackgroundWork:
    """At most one piece of work in a thread of its own, whose failure is that of who asks next.

    A thread and no process: checksums are taken and the disk is waited for without Python's lock,
    and a process that runs torch cannot be forked. The thread does not outlive its work, and the
    interpreter does not end before it.
    """

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def begin(self, work: Callable[[], object]) -> None:
        """Does ``work`` beside the caller, once what was begun before is done.

        Raises:
            BaseException: Whatever the work of before failed with; ``work`` is not begun then.
        """
        self.settle()
        self._thread = threading.Thread(target=partial(self._do, work), name="seal")
        self._thread.start()

    def check(self) -> None:
        """Raises what the work failed with, if it has; waits for nothing."""
        if self._thread is not None and not self._thread.is_alive():
            self.settle()

    def settle(self) -> None:
        """Waits until nothing is under way.

        Raises:
            BaseException: Whatever the work failed with, once.
        """
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def end(self) -> None:
        """As :meth:`settle`, for who is ending with an error already: a failure is only told."""
        try:
            self.settle()
        except Exception as error:
            _logger.error("and the checkpoint that was being written is lost: %s", error)

    def _do(self, work: Callable[[], object]) -> None:
        try:
            work()
        except BaseException as error:
            self._failure = error
