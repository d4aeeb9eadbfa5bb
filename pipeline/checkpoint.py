"""What TorchRL's ``Checkpoint`` needs besides the trainer's own parts to resume exactly.

The trainer registers the policy, the loss, the stepper, the hooks and the buffers.  Two things are
missing for a continuation that equals the uninterrupted run: the collector's position inside its
episodes, and the random generators.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torch import nn
from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation, GlobalRNGState
from torchrl.collectors import BaseCollector

KEEP_LAST = 1
DIRECTORY = "checkpoints"


class CollectorState:
    """Frame counter, current observation and environment of a single-process collector.

    ``Collector.state_dict`` starts fresh episodes on load; here environments that keep their whole
    state (the door does) go on in the middle of theirs.  Gymnasium's and dm_control's cannot be
    restored, so those start fresh episodes: such a resumed run is valid but not bit-identical.

    Args:
        collector: TorchRL ``Collector`` over one batched environment.
    """

    def __init__(self, collector: BaseCollector) -> None:
        self.collector = collector

    def state_dict(self) -> dict[str, Any]:
        """Everything as tensors, numbers and nested dicts."""
        return {
            "frames": self.collector._frames,
            "iter": self.collector._iter,
            "carrier": self.collector._carrier.to_dict(),
            "env": self.collector.env.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave, in place."""
        self.collector._frames = state["frames"]
        self.collector._iter = state["iter"]
        if state["env"]:
            self.collector.env.load_state_dict(state["env"])
            carrier = self.collector._carrier
            carrier.update(TensorDict(state["carrier"], batch_size=carrier.batch_size))


def make_checkpoint(policy: nn.Module, collector_state: Any) -> Checkpoint:
    """The checkpoint to give to the trainer, with the parts it would not save itself.

    Args:
        policy: Saved apart from the loss, so that evaluation loads nothing else.
        collector_state: ``CollectorState``, or a collector whose own ``state_dict`` suffices.
    """
    return Checkpoint(policy=policy, collector=collector_state, rng=GlobalRNGState())


def make_rotation(run_dir: Path) -> CheckpointRotation:
    """Keeps the newest checkpoint below ``run_dir / "checkpoints"``; each is written atomically."""
    return CheckpointRotation(run_dir / DIRECTORY, keep_last=KEEP_LAST)


def latest_checkpoint(run_dir: Path) -> Path:
    """Path of the newest checkpoint of a run.

    Raises:
        FileNotFoundError: If there is none.
    """
    latest = make_rotation(run_dir).latest() if (run_dir / DIRECTORY).is_dir() else None
    if latest is None:
        raise FileNotFoundError(
            f"{run_dir} holds no checkpoint below {DIRECTORY}/; is it a run directory, and did "
            "the run get as far as logging.checkpoint_interval frames?"
        )
    return latest


def load_component(path: Path, name: str, module: nn.Module) -> None:
    """Loads one module of a checkpoint in place.

    Raises:
        ValueError: If the checkpoint is damaged or was written by another architecture.
    """
    try:
        Checkpoint(**{name: module}).load(path, components=[name], map_location="cpu")
    except (CheckpointError, OSError, json.JSONDecodeError, RuntimeError) as error:
        raise ValueError(
            f"Checkpoint {path}: cannot load {name!r} into this network ({error}). Use the "
            "configuration that the run was made with (config.yaml beside its checkpoints)."
        ) from error


