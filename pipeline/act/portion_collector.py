"""Collecting that can be cut short between two steps, and gone on with in another process."""

from __future__ import annotations

from collections.abc import Iterator

import tensordict
from tensordict import TensorDictBase

from pipeline.machine.interruption import StopRequest
from pipeline.machine.threads import OneThreadCollector


class _CutError(Exception):
    """The portion is not complete."""


class PortionCut:
    """What TorchRL's collector asks after each step whether it shall end there (``interruptor``).

    Args:
        stop: The request on which it shall.
    """

    def __init__(self, stop: StopRequest) -> None:
        self.stop = stop
        self.made = 0
        self.owed = 0

    def begin(self, owed: int) -> None:
        """From here on, ``owed`` steps are made, fewer on a request to stop."""
        self.made, self.owed = 0, owed

    def collection_stopped(self) -> bool:
        """Counts a step; whether it is the last one."""
        self.made += 1
        return self.stop.made or self.made == self.owed


class PortionCollector(OneThreadCollector):
    """Ends after the present step on a request to stop; the portion goes on where it was cut.

    The steps that were made of it are in :attr:`begun`, and the environment, the carrier and the
    generators are where they have led: a checkpoint with all of them (``CollectorState``) resumes
    to the portion that was not cut, bit for bit. Nothing is kept ready for it while there is no
    request.

    Args:
        interruptor: A :class:`PortionCut`; the others are those of
            :class:`torchrl.collectors.Collector`.
    """

    begun: TensorDictBase | None = None
    """Steps [N, t] of the portion that was cut; None where none is."""

    def rollout(self) -> TensorDictBase:
        """The portion [N, T]; with what was begun of it before, if it was."""
        before, self.begun = self.begun, None
        whole = self.frames_per_batch  # TorchRL's name: of each environment
        cut: PortionCut = self.interruptor
        cut.begin(whole if before is None else whole - before.shape[-1])
        portion = super().rollout()[..., : cut.made]
        if before is not None:
            portion = tensordict.cat([before, portion], dim=-1)
        if portion.shape[-1] < whole:
            self.begun = portion.clone()  # of a buffer
            raise _CutError
        return portion

    def iterator(self) -> Iterator[TensorDictBase]:
        """Portions until one is cut, and not that one."""
        try:
            yield from super().iterator()
        except _CutError:
            self._iter -= 1  # it is yet to be counted
