"""One way to turn trajectories into replay rows, for experience and demonstrations alike."""

from __future__ import annotations

from collections.abc import Callable

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data.postprocs import MultiStep

ROW_KEYS = (
    "observation",
    "action",
    "steps_to_next_obs",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "terminated"),
)
"""What a row holds; every buffer has exactly these entries, so batches of several can be joined."""


class TransitionRows:
    """Cuts trajectories ``[..., T]`` into flat n-step transitions ``[rows]``.

    A row at time t holds ``sum_k gamma**k r_{t+k}`` over at most ``n_step`` rewards, the
    observation after the last of them and the number of steps in between (``steps_to_next_obs``).
    Rows near the end of an episode, or of the portion handed over, look fewer steps ahead.

    Args:
        gamma: Discount per control step.
        n_step: 1 gives ordinary transitions.
        reward_scale: Factor on every reward.
        bonus: Training reward ``[..., 1]`` of arriving at a next observation ``[..., O]``, added to
            the environment's before scaling.

    Raises:
        ValueError: If ``n_step`` is below 1 or ``gamma`` outside (0, 1].
    """

    def __init__(
        self,
        gamma: float,
        n_step: int = 1,
        reward_scale: float = 1.0,
        bonus: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        self.multi_step = MultiStep(gamma=gamma, n_steps=n_step)
        # MultiStep leaves every done key at t + 1 while it moves the next observation to t + n.
        # The bootstrap needs `terminated` of the observation it bootstraps from; only the keys that
        # mark where to cut may stay.
        self.multi_step.done_keys = ("done", "truncated")
        self.reward_scale = reward_scale
        self.bonus = bonus

    def __call__(self, trajectories: TensorDictBase) -> TensorDictBase:
        """Converts ``[T]`` or ``[N, T]`` trajectories; the input is left as it was."""
        batched = trajectories if trajectories.ndim > 1 else trajectories.unsqueeze(0)
        batched = batched.copy()  # of nested entries too, without their tensors
        if self.bonus is not None:
            after = batched["next"]
            after["reward"] = after["reward"] + self.bonus(after["observation"])
        rows = self.multi_step(batched)
        rows = rows.select(*ROW_KEYS).flatten()
        rows["steps_to_next_obs"] = rows["steps_to_next_obs"].unsqueeze(-1)
        if self.reward_scale != 1.0:
            rows["next", "reward"] = rows["next", "reward"] * self.reward_scale
        return rows
