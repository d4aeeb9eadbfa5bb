"""What TorchRL's ``Checkpoint`` needs besides the trainer's own parts to resume exactly.

The trainer registers the policy, the loss, the stepper, the hooks and the buffers.  Two things are
missing for a continuation that equals the uninterrupted run: the collector's position inside its
episodes, and the random generators.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torch import nn
from torchrl.checkpoint import (
    Checkpoint,
    CheckpointAdapter,
    CheckpointRotation,
    GlobalRNGState,
)
from torchrl.collectors import BaseCollector
from torchrl.data import ReplayBuffer
from torchrl.envs import EnvBase
from torchrl.trainers import Trainer

KEEP_LAST = 1
DIRECTORY = "checkpoints"
PICKLES = ("*.pkl", "*.pickle")


class BufferAdapter(CheckpointAdapter):
    """A replay buffer as its rows and the state of its writer.

    TorchRL's own dump of a buffer holds a pickle, whose reading can run anything, fails while the
    buffer is empty, and does not fit a buffer of another capacity (a run that goes on for longer).
    """

    adapter_id = "door.replay_buffer"
    rows = "rows"
    writer = "writer.json"

    def save(self, component: ReplayBuffer, path: Path, **_options: Any) -> None:
        """Writes the rows and the writer's state below ``path``."""
        path.mkdir(parents=True, exist_ok=True)
        if len(component) > 0:
            component[:].cpu().memmap(path / self.rows, copy_existing=True)
        (path / self.writer).write_text(json.dumps(component.writer.state_dict()))

    def load(self, component: ReplayBuffer, path: Path, **_options: Any) -> None:
        """Replaces what ``component`` holds."""
        component.empty()
        if (path / self.rows).is_dir():
            rows = TensorDict.load_memmap(path / self.rows)
            component.extend(rows.to(component.storage.device))
        # In a ring that is larger than the saved one, the next row goes behind the last.
        if len(component) == component.storage.max_size:
            component.writer.load_state_dict(json.loads((path / self.writer).read_text()))


def resumes_midway(env: EnvBase) -> bool:
    """Whether ``env`` saves its whole state, so that an episode can go on after a restart.

    A ``state_dict`` alone does not say so: those of gymnasium's and dm_control's environments hold
    the constants of their transforms and nothing of the simulation.
    """
    return type(env).get_extra_state is not nn.Module.get_extra_state


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
        if resumes_midway(self.collector.env):
            self.collector.env.load_state_dict(state["env"])
            carrier = self.collector._carrier
            saved = TensorDict(state["carrier"], carrier.batch_size, device=carrier.device)
            carrier.update(saved)


def make_checkpoint(policy: nn.Module, collector_state: Any) -> Checkpoint:
    """The checkpoint to give to the trainer, with the parts it would not save itself.

    Args:
        policy: Saved apart from the loss, so that evaluation loads nothing else.
        collector_state: ``CollectorState``, or a collector whose own ``state_dict`` suffices.
    """
    checkpoint = Checkpoint(policy=policy, collector=collector_state, rng=GlobalRNGState())
    return checkpoint.register_adapter(ReplayBuffer, BufferAdapter())


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


def trained_frames(path: Path) -> int:
    """Frames that had been collected when checkpoint ``path`` was written."""
    return int(Checkpoint.manifest(path)["metadata"]["collected_frames"])


def load_component(path: Path, name: str, module: nn.Module) -> None:
    """Loads one module of a checkpoint in place.

    Raises:
        ValueError: If the checkpoint is damaged, holds pickles or is of another architecture.
    """
    with _explained(path, components=f"*-{name}"):
        Checkpoint(**{name: module}).load(path, components=[name], map_location="cpu")


def load_trainer(path: Path, trainer: Trainer) -> None:
    """Restores a whole run in place.

    Raises:
        ValueError: If the checkpoint is damaged, holds pickles or is of another architecture.
    """
    # Not trainer.load_from_file: it also pushes the policy to the collector, in a form that a
    # collector of one process does not take; here both act with the module that was loaded.
    with _explained(path, components="*"):
        trainer.checkpoint.load(path, map_location="cpu")


@contextmanager
def _explained(path: Path, components: str) -> Iterator[None]:
    for folder in path.glob(f"components/{components}"):
        if pickles := _pickles(folder):
            raise ValueError(
                f"Checkpoint {path} holds {pickles[0].name}. Checkpoints of this project hold no "
                "pickles, since reading one can run anything: use the original checkpoint."
            )
    try:
        yield
    except (OSError, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"Checkpoint {path} does not fit this configuration or is damaged ({error}). Use the "
            "configuration that the run was made with (config.yaml beside its checkpoints)."
        ) from error


def _pickles(folder: Path) -> list[Path]:
    return [file for pattern in PICKLES for file in sorted(folder.rglob(pattern))]
