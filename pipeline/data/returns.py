"""What an episode still earns after each of its steps, and where it ends."""

from __future__ import annotations

from typing import Final

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives.value.functional import reward2go

TO_END: Final = "to_end"
"""Key of a row's way to the end of its episode: ``reward``, ``steps``, ``observation`` and
``terminated``, which are those of a row that looks so many steps ahead. No ``steps``: unknown."""


def way_to_end(after: TensorDictBase, gamma: float) -> TensorDict:
    """The way from each step of trajectories to the end of its episode.

    Args:
        after: ``[N, T]``, what followed each step; an episode ends where it is ``done``, and with
            the last step.
        gamma: Discount per control step.

    Returns:
        ``[N, T]`` with ``reward [N, T, 1]``, the discounted sum of the step's reward and all later
        ones of its episode; ``steps [N, T, 1]``, how many these are; ``observation [N, T, O]``,
        with which the episode ends; ``terminated [N, T, 1]``, whether that is its own end.
    """
    done = after["done"]
    steps = reward2go(torch.ones_like(after["reward"]), done, 1.0).round().long()
    last = torch.arange(done.shape[1], device=done.device) + steps.squeeze(-1) - 1
    ends = after.select("observation", "terminated").gather(1, last)
    return TensorDict(
        {
            "reward": reward2go(after["reward"], done, gamma),
            "steps": steps,
            "observation": ends["observation"],
            "terminated": ends["terminated"],
        },
        batch_size=after.batch_size,
        device=after.device,
    )


def unknown_way(rows: TensorDictBase) -> TensorDict:
    """The way of rows whose episodes' ends are not known, of the same shape."""
    shape = (*rows.batch_size, 1)
    flag = torch.zeros(shape, dtype=torch.bool, device=rows.device)
    return TensorDict(
        {
            "reward": torch.zeros_like(rows["next", "reward"]),
            "steps": flag.long(),
            "observation": torch.zeros_like(rows["observation"]),
            "terminated": flag,
        },
        batch_size=rows.batch_size,
        device=rows.device,
    )
