"""Episodes as TensorDicts, with the keys that the collector and the losses use."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from envs.demonstrations.episode import Episode
from envs.task import PROGRESS, SUCCESS

IMITATED_ACTION = "imitated_action"
"""Key of the action to imitate, where that is not the one that was executed (``action``)."""


def to_tensordict(episodes: Iterable[Episode], *, executed: bool = True) -> list[TensorDict]:
    """One TensorDict [T] per episode, as the task's environment would have recorded it.

    Keys: ``observation`` [T, O], ``action`` [T, A] clipped to [-1, 1] and, under ``next``,
    ``observation`` [T, O], ``reward`` [T, 1] (all float32) and ``done``, ``terminated``,
    ``truncated`` [T, 1] (bool). The last step is ``done``: terminated where the episode says so,
    else truncated, so that its value is still bootstrapped. Where the episode knows them,
    ``success`` [T, 1] (bool) and ``progress`` [T, 1], both at the root and under ``next``. Where
    one of the episodes executed other actions than those that it shows, ``action`` is what was
    executed, which is what the observations and rewards follow from, and all have
    ``imitated_action`` [T, A].

    Args:
        episodes: validated episodes.
        executed: whether ``action`` is the executed action; else it is the one that is shown.

    Returns:
        TensorDicts on the CPU that share no memory with the episodes.
    """
    episodes = list(episodes)
    both = executed and any(episode.executed_actions is not None for episode in episodes)
    return [_to_tensordict(episode, both) for episode in episodes]


def _to_tensordict(episode: Episode, both: bool) -> TensorDict:
    observations = torch.from_numpy(episode.observations)
    terminated = torch.tensor(episode.terminated, dtype=torch.bool).unsqueeze(-1)
    done = terminated.clone()
    done[-1] = True
    steps = TensorDict(
        {
            "observation": observations[:-1].clone(),
            "action": _clipped(episode.played_actions if both else episode.actions),
            **({IMITATED_ACTION: _clipped(episode.actions)} if both else {}),
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
    for key, column in ((SUCCESS, episode.success), (PROGRESS, episode.progress)):
        if column is not None:
            values = torch.from_numpy(np.array(column)).unsqueeze(-1)
            steps[key], steps["next", key] = values[:-1].clone(), values[1:].clone()
    return steps


def _clipped(actions: NDArray[np.float32]) -> Tensor:
    # Environments clip, so the clipped action is the one that was executed; a tanh policy cannot
    # represent anything beyond.
    return torch.tensor(actions, dtype=torch.float32).clamp_(-1.0, 1.0)
