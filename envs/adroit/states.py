"""States of the joints in demonstrations, at which episodes can begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from envs.adroit.hand import HandTask
from envs.adroit.replay import Replay
from envs.adroit.resimulation import BATCH, QPOS, QVEL, play
from envs.adroit.simulator import HandSimulator
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError

ALIKE: Final = 1e-3
"""Largest difference between an observation of an episode and that of its replay."""


@dataclass(frozen=True)
class States:
    """Plays episodes and keeps where everything is after each step.

    A state is that of the joints and of what is placed. What the solver remembers of the step
    before is forgotten, as at any start.
    """

    task: HandTask

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[TensorDict]:
        """What to reset a copy with, [T + 1] for each episode: placement, ``qpos`` and ``qvel``.

        Args:
            episodes: as the simulator plays them.
            num_threads: of the simulator, default all available cores. No effect on the result.

        Raises:
            DemonstrationError: an episode does not say where things stand, or its observations are
                not those of its replay.
        """
        if not episodes:
            return []
        size = min(len(episodes), BATCH)
        found: list[TensorDict] = []
        with HandSimulator(self.task, size, num_threads) as simulator:
            for first in range(0, len(episodes), size):
                found += _states(simulator, episodes[first : first + size])
        return found


def _states(simulator: HandSimulator, batch: Sequence[Episode]) -> list[TensorDict]:
    seen: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []

    def keep(_: int, played: Replay) -> NDArray[np.bool_]:
        seen.append((simulator.qpos, simulator.qvel))
        return np.ones(len(played.steps), dtype=bool)

    played = play(simulator, batch, keep)
    qpos, qvel = (np.stack(part, axis=1) for part in zip(*seen, strict=True))
    placement = simulator.placement
    found = []
    for i, episode in enumerate(batch):
        replayed = played.observations[i, : episode.length + 1]
        if not np.allclose(replayed, episode.observations, atol=ALIKE):
            raise DemonstrationError(
                episode.provenance,
                "is not what the simulator plays, so no episode can begin within it",
                "Load it with re-simulation (demos.resimulate=true)",
            )
        of_one = {
            name: np.tile(values[i], (episode.length + 1, 1)) for name, values in placement.items()
        }
        for key, steps in ((QPOS, qpos), (QVEL, qvel)):
            first = episode.start.get(key, np.zeros(steps.shape[-1]))
            of_one[key] = np.concatenate([first[None], steps[i, : episode.length]])
        arrays = {key: torch.from_numpy(values) for key, values in of_one.items()}
        found.append(TensorDict(arrays, [episode.length + 1]))
    return found
