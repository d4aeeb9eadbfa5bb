"""One way to turn trajectories into replay rows, for experience and demonstrations alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import tensordict
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data.postprocs import MultiStep

from envs.demonstrations import IMITATED_ACTION
from pipeline.data.returns import TO_END, unknown_way, way_to_end

ROW_KEYS = (
    "observation",
    "action",
    "steps_to_next_obs",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "terminated"),
)
"""What every row holds. Some rows of demonstrations have more (:data:`FILLED`)."""

FILLED: Final[Mapping[str, Callable[[TensorDictBase], Any]]] = {
    # Where the executed actions are not those to imitate.
    IMITATED_ACTION: lambda rows: rows["action"],
    # Where something learns from whole episodes.
    TO_END: unknown_way,
    # Where a buffer gave them, which tells their place in it; rows of one's own may have none.
    "index": lambda rows: rows["action"].new_full(rows.shape, -1, dtype=torch.int64),
}
"""What only some rows have, and what it is for the others beside them."""


def joined(parts: Sequence[TensorDictBase], dim: int) -> TensorDictBase:
    """Rows of several buffers along ``dim``; what one part has alone is filled in for the others.

    Where one says which action to imitate, the others' is the one that was executed.
    """
    if len(parts) == 1:
        return parts[0]
    for key, fill in FILLED.items():
        has = [key in part.keys() for part in parts]  # noqa: SIM118
        if any(has) and not all(has):
            parts = [
                part if known else part.copy().set(key, fill(part))
                for part, known in zip(parts, has, strict=True)
            ]
    rows: TensorDictBase = tensordict.cat(list(parts), dim=dim)
    return rows


class TransitionRows:
    """Cuts trajectories ``[..., T]`` into flat n-step transitions ``[rows]``.

    A row at time t holds ``sum_k gamma**k r_{t+k}`` over at most ``n_step`` rewards, the
    observation after the last of them and the number of steps in between (``steps_to_next_obs``).
    Rows near the end of an episode, or of the portion handed over, look fewer steps ahead;
    :class:`~pipeline.data.portions.PortionRows` joins portions.

    Args:
        gamma: Discount per control step.
        n_step: 1 gives ordinary transitions.
        reward_scale: Factor on every reward.
        bonus: Training reward ``[..., 1]`` of what an environment wrote after an action, added to
            its own before scaling.
        columns: Further entries of a step that rows keep, ``progress`` for instance.
        to_end: Whether rows hold the way to the end of their episode
            (:func:`~pipeline.data.returns.way_to_end`); the trajectories must be whole episodes.
        chunk: Actions of a row, its own and those that follow, ``[rows, chunk A]``; with more than
            one there are no rows that look less far ahead (Q-chunking, arXiv:2507.07969).

    Raises:
        ValueError: If ``n_step`` is below 1 or below ``chunk``, or ``gamma`` outside (0, 1].
    """

    def __init__(
        self,
        gamma: float,
        n_step: int = 1,
        reward_scale: float = 1.0,
        bonus: Callable[[TensorDictBase], Tensor] | None = None,
        columns: Sequence[str] = (),
        *,
        to_end: bool = False,
        chunk: int = 1,
    ) -> None:
        if chunk > 1 and n_step != chunk:
            raise ValueError(f"rows of {chunk} actions look as many steps ahead, got {n_step}.")
        self.multi_step = MultiStep(gamma=gamma, n_steps=n_step)
        # MultiStep leaves every done key at t + 1 while it moves the next observation to t + n.
        # The bootstrap needs `terminated` of the observation it bootstraps from; only the keys that
        # mark where to cut may stay.
        self.multi_step.done_keys = ("done", "truncated")
        self.n_step = n_step
        self.reward_scale = reward_scale
        self.bonus = bonus
        self.gamma = gamma
        self.to_end = to_end
        self.chunk = chunk
        self.keys = (*ROW_KEYS, *columns, *([TO_END] if to_end else []))

    def __call__(self, trajectories: TensorDictBase) -> TensorDictBase:
        """Converts ``[T]`` or ``[N, T]`` trajectories; the input is left as it was."""
        return self.whole(self.each(trajectories))

    def whole(self, rows: TensorDictBase) -> TensorDictBase:
        """Those rows that have all of their actions."""
        if self.chunk == 1:
            return rows
        return rows[rows["steps_to_next_obs"].squeeze(-1) == self.chunk]

    def each(self, trajectories: TensorDictBase) -> TensorDictBase:
        """A row for each step, whether or not an episode ends within its actions."""
        batched = trajectories if trajectories.ndim > 1 else trajectories.unsqueeze(0)
        batched = batched.copy()  # of nested entries too, without their tensors
        if self.bonus is not None:
            after = batched["next"]
            after["reward"] = after["reward"] + self.bonus(after)
        for key in ("action", IMITATED_ACTION) if self.chunk > 1 else ():
            if key in batched.keys():  # noqa: SIM118
                batched[key] = _chunks(batched[key], self.chunk)
        if self.to_end:
            batched[TO_END] = way_to_end(batched["next"], self.gamma)
        rows = self.multi_step(batched)
        # Rows of demonstrations have a further action where another was executed.
        kept = [IMITATED_ACTION] if IMITATED_ACTION in rows.keys() else []  # noqa: SIM118
        rows = rows.select(*self.keys, *kept).flatten()
        rows["steps_to_next_obs"] = rows["steps_to_next_obs"].unsqueeze(-1)
        if self.reward_scale != 1.0:
            rows["next", "reward"] = rows["next", "reward"] * self.reward_scale
            if self.to_end:
                rows[TO_END, "reward"] = rows[TO_END, "reward"] * self.reward_scale
        return rows


def _chunks(actions: Tensor, length: int) -> Tensor:
    """Each action ``[N, T, A]`` with those after it, ``[N, T, length A]``; the last one repeats."""
    steps = actions.shape[1]
    ahead = torch.arange(steps, device=actions.device)[:, None] + torch.arange(
        length, device=actions.device
    )
    return actions[:, ahead.clamp(max=steps - 1)].flatten(-2)
