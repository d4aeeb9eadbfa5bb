"""Whether tensors are finite, at the cost of one number, and where the first is that is not."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pipeline.non_finite import NonFiniteError


@torch.no_grad()
def finite(tensors: Iterable[Tensor]) -> Tensor:
    """A number [] that is finite if all entries of all tensors are, on their device.

    It is a sum, so it also is not where finite entries add up to more than float32 holds.
    """
    return torch.stack([tensor.sum() for tensor in tensors]).sum()


def described(values: Tensor) -> str:
    """The first entry that is not finite: its value and where it is."""
    where = (~values.isfinite()).nonzero()[0].tolist()
    return f"{values[tuple(where)].item()} at {where}"


def require_finite_step(steps: TensorDictBase, active: Tensor) -> None:
    """Refuses to judge a policy by numbers that are not finite.

    Args:
        steps: What one step of N environments took and told.
        active: Whose episodes are not over, bool [N, 1].

    Raises:
        NonFiniteError: If an action, a reward or an observation of one of them is not finite.
    """
    after = steps["next"]
    told = {"action": steps["action"], "reward": after["reward"]}
    told["observation"] = after["observation"]
    if finite(values * active for values in told.values()).isfinite():
        return
    for key, values in told.items():
        bad = (~values.isfinite()).reshape(len(active), -1).any(-1) & active.squeeze(-1)
        if bad.any():
            copy = int(bad.nonzero()[0])
            whose = "the policy's weights" if key == "action" else "the environment's numbers"
            raise NonFiniteError(
                f"{key} is {described(values[copy])} in evaluation episode {copy} of those that "
                f"are stepped together: {whose} are not finite.",
                steps.exclude("_step", "_reset"),
            )
