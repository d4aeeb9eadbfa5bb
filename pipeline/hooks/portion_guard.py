"""Nothing that is not finite gets into a buffer."""

from __future__ import annotations

from typing import Final

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.finite import finite
from pipeline.non_finite import NonFiniteError

TOLD: Final[dict[NestedKey, str]] = {
    "observation": "the environment begins with it: look at its reset()",
    "action": "the policy gave it: its weights or what it was shown are not finite",
    ("next", "reward"): "the environment paid it: look at its reward in that state, or at "
    "task.reward",
    ("next", "observation"): "the environment showed it: a simulation that diverges, or a division "
    "by zero in what is observed",
}
"""What collected steps must hold finite numbers in, in the order in which a step has them, and what
it means where they are not."""


class PortionGuard(TrainerHookBase):
    """Looks at every collected portion before anything else does.

    Raises:
        NonFiniteError: From a call, with the first frame, key and copy.
    """

    def __init__(self) -> None:
        self._trainer: Trainer | None = None

    def __call__(self, portion: TensorDictBase) -> TensorDictBase:
        """Takes ``portion`` [N, T] and hands it on unchanged."""
        told = {key: portion[key] for key in TOLD if key in portion.keys(include_nested=True)}
        if told and not finite(told.values()).isfinite():
            self._refuse(portion, told)
        return portion

    def _refuse(self, portion: TensorDictBase, told: dict[NestedKey, torch.Tensor]) -> None:
        steps = portion.shape[-1]
        found = []
        for place, (key, values) in enumerate(told.items()):
            bad = ~values.isfinite().reshape(-1, steps, values[0, 0].numel()).all(-1)  # [N, T]
            for copy, step in bad.nonzero().tolist():
                found.append((step, place, copy, key))
        if not found:
            return  # finite, but more than a sum in float32 holds
        step, _, copy, key = min(found, key=lambda entry: entry[:3])
        before = 0 if self._trainer is None else self._trainer.collected_frames
        frame = before + step * (portion.numel() // steps) + copy + 1
        name = ".".join(key) if isinstance(key, tuple) else key
        value = told[key].reshape(-1, steps, told[key][0, 0].numel())[copy, step]
        raise NonFiniteError(
            f"{name} is {value[~value.isfinite()][0].item()} at frame {frame} (environment copy "
            f"{copy}): {TOLD[key]}.",
            portion,
        )

    def register(self, trainer: Trainer, name: str = "portion_guard") -> None:
        """Registers at ``batch_process``; before the hooks that store, if it is registered first.

        It has no state.
        """
        self._trainer = trainer
        trainer.register_op("batch_process", self)
