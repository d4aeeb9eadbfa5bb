"""Numbers that are not finite end a run where they appear, with what they were found in."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import torch
from safetensors.torch import save
from tensordict import TensorDictBase
from torch import Tensor

BATCH = "non_finite.safetensors"
"""In the run directory: what the numbers were found in, by key, and the message as metadata."""
EXIT_CODE = 3


class NonFiniteError(ValueError):
    """A NaN or an infinity; the message says where, since when and what makes one like it.

    Args:
        message: Key or term, update or frame, and the likely cause.
        batch: What it was found in, if anything can be kept of it.
    """

    def __init__(self, message: str, batch: TensorDictBase | None = None) -> None:
        super().__init__(message)
        self.batch = batch

    def kept(self, run_dir: Path) -> NonFiniteError:
        """The same with the batch written into ``run_dir``, and its message saying so."""
        if self.batch is None:
            return self
        path = run_dir / BATCH
        leaves = self.batch.items(include_nested=True, leaves_only=True)
        tensors = {
            ".".join(key) if isinstance(key, tuple) else key: value.detach().cpu().contiguous()
            for key, value in leaves
            if isinstance(value, Tensor)
        }
        # Not save_file: what it writes its owner alone can read, whatever the umask.
        path.write_bytes(save(tensors, metadata={"message": str(self)}))
        return NonFiniteError(f"{self} The batch is in {path}; checkpoints are as they were.")


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
