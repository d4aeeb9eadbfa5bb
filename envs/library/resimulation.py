"""Recorded episodes played again in a library's environment, where it can begin as they did."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase

from envs.demonstrations.episode import Episode
from envs.library.starts import Place, StartState
from envs.library.vector_env import START_SEED, VectorEnv
from envs.steps import count_steps
from envs.task import PROGRESS, SUCCESS

_logger = logging.getLogger(__name__)
ALIKE: Final = 1e-3
"""Largest difference of a first observation for a seed to have begun the recorded episode."""


@dataclass(frozen=True)
class Resimulation:
    """Replays episodes, one after the other.

    Attributes:
        name: of the task.
        make_env: makes one copy.
        start: how a recorded state is put into it; None if only seeds can begin an episode.
    """

    name: str
    make_env: Callable[[], VectorEnv]
    start: StartState | None

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[Episode]:
        """The episodes as the task plays their actions; those without a start as they are.

        Args:
            episodes: with actions in [-1, 1].
            num_threads: of no effect.
        """
        env = self.make_env()
        try:
            played = [self._play(env, episode) for episode in episodes]
        finally:
            env.close()
        kept = sum(episode.provenance.kind != "resimulated" for episode in played)
        if kept:
            needed = [] if self.start is None else [key.name for key in self.start.keys]
            _logger.warning(
                "%d of %d episodes are used as they were recorded, not played again: they do not "
                "say how task %s begins them. Record them with %s, or set demos.resimulate=false "
                "if that is meant", kept, len(played), self.name,
                " or ".join(filter(None, [f"their {START_SEED}", " + ".join(needed)])),
            )  # fmt: skip
        return played

    def _play(self, env: VectorEnv, episode: Episode) -> Episode:
        td = self.begin(env, episode)
        if td is None:
            return episode
        steps = [td]
        for action in episode.actions:
            td = td.select("observation").set("action", torch.as_tensor(action)[None])
            td = env.step(td)["next"]
            steps.append(td)
            if td["terminated"].any():
                break
        count = len(steps) - 1
        count_steps(count)
        return dataclasses.replace(
            episode,
            observations=torch.cat([step["observation"] for step in steps]).numpy(),
            actions=episode.actions[:count],
            rewards=_flat(steps[1:], "reward"),
            terminated=_flat(steps[1:], "terminated"),
            provenance=dataclasses.replace(episode.provenance, kind="resimulated"),
            success=_column(steps, SUCCESS, episode.success),
            progress=_column(steps, PROGRESS, episode.progress),
        )

    def begin(self, env: VectorEnv, episode: Episode) -> Any:
        """Puts the only copy of ``env`` where the episode begins; gives what a reset gives.

        None if the episode holds nothing by which it could be.
        """
        seed = episode.start.get(START_SEED)
        given = (
            None if seed is None else TensorDict({START_SEED: torch.as_tensor(seed).long()}, [1])
        )
        td = env.reset(given)
        if self.start is not None and all(key.name in episode.start for key in self.start.keys):
            return env.place(Place(self.start, episode.start))
        begun = td["observation"][0].numpy()
        if seed is not None and np.allclose(begun, episode.observations[0], atol=ALIKE):
            return td
        return None


def _flat(steps: Sequence[TensorDictBase], key: str) -> NDArray[Any]:
    return torch.cat([step[key].reshape(-1) for step in steps]).numpy()


def _column(steps: Sequence[TensorDictBase], key: str, recorded: Any) -> Any:
    if key in steps[0]:
        return _flat(steps, key)
    return None if recorded is None else recorded[: len(steps)]
