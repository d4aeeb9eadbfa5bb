"""Episodes as TensorDicts, with the keys that the collector and the losses use."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from tensordict import TensorDict

from envs.demonstrations.episode import Episode


def to_tensordict(episodes: Iterable[Episode]) -> list[TensorDict]:
    """One TensorDict [T] per episode, as `envs.door.DoorEnv` would have recorded it.

    Keys: ``observation`` [T, 38], ``action`` [T, 28] clipped to [-1, 1] and, under ``next``,
    ``observation`` [T, 38], ``reward`` [T, 1] (all float32) and ``done``, ``terminated``,
    ``truncated`` [T, 1] (bool). The last step is ``done``: terminated where the episode says so,
    else truncated, so that its value is still bootstrapped.

    Args:
        episodes: validated episodes.

    Returns:
        TensorDicts on the CPU that share no memory with the episodes.
    """
    return [_to_tensordict(episode) for episode in episodes]


def _to_tensordict(episode: Episode) -> TensorDict:
    observations = torch.from_numpy(episode.observations)
    terminated = torch.tensor(episode.terminated, dtype=torch.bool).unsqueeze(-1)
    done = terminated.clone()
    done[-1] = True
    return TensorDict(
        {
            "observation": observations[:-1].clone(),
            # The simulator clips, so the clipped action is the one that was executed; a tanh
            # policy cannot represent anything beyond.
            "action": torch.tensor(episode.actions, dtype=torch.float32).clamp_(-1.0, 1.0),
            "next": {
                "observation": observations[1:].clone(),
                "reward": torch.tensor(episode.rewards, dtype=torch.float32).unsqueeze(-1),
                "done": done,
                "terminated": terminated,
                "truncated": done & ~terminated,
            },
        },
        batch_size=[episode.length],
    )
