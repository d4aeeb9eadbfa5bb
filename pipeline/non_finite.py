"""Numbers that are not finite end a run where they appear, with what they were found in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tensordict import TensorDictBase

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
        # Only with a batch: who reads files alone names this error without torch.
        from safetensors.torch import save  # noqa: PLC0415
        from torch import Tensor  # noqa: PLC0415

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
