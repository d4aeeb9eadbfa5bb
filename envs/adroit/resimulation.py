"""Play recorded episodes in our own simulator: true states, our reward, our success."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import HandTask
from envs.adroit.replay import KeepGoing, Replay, replay
from envs.adroit.simulator import HandSimulator
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError

#: Copies stepped together. More would only raise the memory; the result does not depend on it.
BATCH = 64
QPOS = "qpos"
"""Joint positions before the first action, [nq], rad (slides: m): those of the hand first."""
QVEL = "qvel"
"""Their velocities, [nv]."""


@dataclass(frozen=True)
class Resimulation:
    """Replays the executed actions of episodes, open loop, from where they were recorded.

    An episode begins in its recorded state, or, where the file holds none, in the pose in which the
    task begins. The replayed episode holds the states that a policy will really see, and the task's
    reward; actions stay as recorded.

    Attributes:
        task: plays them.
        prepare: gives an episode the start from which it is to be played, where that is not the
            recorded one; it raises a `DemonstrationError` where it cannot.
    """

    task: HandTask
    prepare: Callable[[Episode], Episode] | None = None

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[Episode]:
        """Episodes of kind ``resimulated``, in the same order.

        Args:
            episodes: with actions and where things stand (``start``).
            num_threads: of the simulator, default all available cores. No effect on the result.

        Raises:
            DemonstrationError: the physics diverges, an episode does not say where things stand, or
                `prepare` raises one.
        """
        played: list[Episode] = []
        if not episodes:
            return played
        if self.prepare is not None:
            episodes = [self.prepare(episode) for episode in episodes]
        size = min(len(episodes), BATCH)
        with HandSimulator(self.task, size, num_threads) as simulator:
            for first in range(0, len(episodes), size):
                batch = episodes[first : first + size]
                result = play(simulator, batch)
                played += [_resimulated(one, result, i) for i, one in enumerate(batch)]
        return played


def play(
    simulator: HandSimulator, batch: Sequence[Episode], keep_going: KeepGoing | None = None
) -> Replay:
    """Play episodes in the first copies of ``simulator``, each from where it begins.

    Raises:
        DemonstrationError: an episode does not say where things stand.
    """
    # The last batch may be smaller than the simulator: idle copies play nothing.
    count = simulator.num_copies
    rows = [*range(len(batch)), *[0] * (count - len(batch))]
    lengths = np.array([episode.length for episode in batch])[rows]
    lengths[len(batch) :] = 0
    actions = np.zeros((count, lengths.max(), simulator.task.action_size))
    for i, episode in enumerate(batch):
        actions[i, : episode.length] = episode.played_actions
    for episode in batch:
        _require_placement(episode, simulator)
    return replay(
        simulator,
        actions,
        lengths,
        {
            name: np.stack([episode.start[name] for episode in batch])[rows]
            for name in simulator.placement
        },
        qpos=_stacked(batch, QPOS, simulator.scene.model.nq)[rows],
        qvel=_stacked(batch, QVEL, simulator.scene.model.nv)[rows],
        keep_going=keep_going,
    )


def _stacked(batch: Sequence[Episode], name: str, size: int) -> NDArray[np.float64]:
    return np.stack([episode.start.get(name, np.zeros(size)) for episode in batch])


def _require_placement(episode: Episode, simulator: HandSimulator) -> None:
    missing = sorted(simulator.placement.keys() - episode.start.keys())
    if missing:
        raise DemonstrationError(
            episode.provenance,
            f"has no {' and no '.join(missing)}, which playing it again needs",
            "Load it without re-simulation (demos.resimulate=false), or store it in the file",
        )


def _resimulated(episode: Episode, result: Replay, index: int) -> Episode:
    steps = int(result.steps[index])
    if result.diverged[index]:
        raise DemonstrationError(
            episode.provenance,
            f"makes the physics diverge at step {steps}",
            "Load it without re-simulation, or remove the episode",
        )
    return dataclasses.replace(
        episode,
        observations=result.observations[index, : steps + 1].copy(),
        actions=episode.actions[:steps],
        rewards=result.rewards[index, :steps].copy(),
        terminated=result.terminated[index, :steps].copy(),
        provenance=dataclasses.replace(episode.provenance, kind="resimulated"),
        success=result.success[index, : steps + 1].copy(),
        progress=result.progress[index, : steps + 1].copy(),
        executed_actions=(
            None if episode.executed_actions is None else episode.executed_actions[:steps]
        ),
    )
