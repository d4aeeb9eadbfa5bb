"""Keeps what the hand touched in every episode of an evaluation."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from envs.contacts import FORCES, OPPOSITION, Contacts
from pipeline.act.metrics import Rollouts
from pipeline.act.strategies import DEFAULT, Strategies, Thresholds, told

Floats = NDArray[np.float32]


class ContactRecorder:
    """Contacts after each step, of an environment made with `EnvOptions.contacts`."""

    def __init__(self) -> None:
        self._steps: list[tuple[Tensor, Tensor]] = []
        self._waves: list[tuple[Floats, Floats]] = []

    def __call__(self, step: TensorDictBase, active: Tensor) -> None:
        """Takes a step of N copies, of which only the ``active`` ones [N, 1] still play."""
        after = step["next"]
        self._steps.append((after[FORCES] * active, after[OPPOSITION] * active))

    def finish_wave(self) -> None:
        """The copies have played their episodes to the end; others follow."""
        forces, opposition = (torch.stack(part, 1) for part in zip(*self._steps, strict=True))
        self._waves.append((forces.cpu().numpy(), opposition[..., 0].cpu().numpy()))
        self._steps = []

    def strategies(
        self, contacts: Contacts, rollouts: Rollouts, thresholds: Thresholds = DEFAULT
    ) -> Strategies:
        """What the recorded episodes were; see `pipeline.act.strategies.told`.

        Args:
            contacts: Of the task.
            rollouts: Of these episodes; the last wave may have played more.
            thresholds: Of the classes.
        """
        assert rollouts.progress is not None, "a task that records contacts tells its progress"
        assert rollouts.success is not None, "and its success"
        count, steps = rollouts.progress.shape
        forces = np.concatenate([_padded(f, steps) for f, _ in self._waves])[:count]
        opposition = np.concatenate([_padded(o, steps) for _, o in self._waves])[:count]
        return told(
            contacts,
            forces.reshape(count, steps, len(contacts.parts), len(contacts.targets)),
            opposition,
            rollouts.progress,
            rollouts.success,
            thresholds,
        )


def _padded(values: Floats, steps: int) -> Floats:
    beyond = [(0, 0)] * values.ndim
    beyond[1] = (0, steps - values.shape[1])
    return np.pad(values, beyond)
