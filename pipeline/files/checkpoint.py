"""What TorchRL's ``Checkpoint`` needs besides the trainer's own parts to resume exactly.

The trainer registers the policy, the loss, the stepper, the hooks and the buffers.  Two things are
missing for a continuation that equals the uninterrupted run: the collector's position inside its
episodes, and the random generators.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.checkpoint import Checkpoint, CheckpointAdapter, GlobalRNGState
from torchrl.collectors import BaseCollector
from torchrl.data import ReplayBuffer
from torchrl.envs import EnvBase
from torchrl.trainers import Trainer

from pipeline.files.rotation import SummedCheckpoint
from pipeline.files.run_files import CHECKPOINTS
from pipeline.files.run_format import latest_of, verify_checkpoint
from pipeline.files.sums import DamagedError

_logger = logging.getLogger(__name__)


class BufferAdapter(CheckpointAdapter):
    """A replay buffer as its rows and the state of its writer.

    TorchRL's own dump of a buffer holds a pickle, whose reading can run anything, fails while the
    buffer is empty, and does not fit a buffer of another capacity (a run that goes on for longer).
    """

    # Written into checkpoints and compared when they are read: by another, no run there is goes on.
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

    A ``state_dict`` alone does not say so: those of TorchRL's wrappers hold the constants of their
    transforms and nothing of the simulation. An environment with a state of its own
    (``get_extra_state``) that is not the whole one says so by ``resumes_midway = False``.
    """
    return _has_state(env) and getattr(env, "resumes_midway", True)


def _has_state(env: EnvBase) -> bool:
    return type(env).get_extra_state is not nn.Module.get_extra_state


class CollectorState:
    """Frame counter, current observation and environment of a single-process collector.

    ``Collector.state_dict`` starts fresh episodes on load; here environments that keep their whole
    state (the door does, and those of others that ``envs/library/state.py`` can save) go on in the
    middle of theirs, and in the middle of a portion that was cut (``PortionCollector``).  Others
    start fresh episodes and a fresh portion: such a resumed run is valid but not bit-identical.

    Args:
        collector: TorchRL ``Collector`` over one batched environment.
    """

    def __init__(self, collector: BaseCollector) -> None:
        self.collector = collector

    def state_dict(self) -> dict[str, Any]:
        """Everything as tensors, numbers and nested dicts."""
        begun = getattr(self.collector, "begun", None)
        return {
            "frames": self.collector._frames,
            "iter": self.collector._iter,
            "carrier": self.collector._carrier.to_dict(),
            "env": self.collector.env.state_dict(),
            "begun": {} if begun is None else begun.to_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave, in place."""
        self.collector._frames = state["frames"]
        self.collector._iter = state["iter"]
        env, carrier = self.collector.env, self.collector._carrier
        whole = _paths(env.state_dict()) <= _paths(state["env"])
        if _has_state(env):
            env.load_state_dict(state["env"])
        # What was saved before an environment could save its whole state says where no episode is.
        if resumes_midway(env) and whole:
            saved = TensorDict(state["carrier"], carrier.batch_size, device=carrier.device)
            carrier.update(saved)
            self._go_on_with(state.get("begun"))  # checkpoints of before have none
        else:
            _logger.warning(
                "this environment cannot be put back into the middle of an episode: the run goes "
                "on with fresh episodes, and not bit for bit as it would have"
            )

    def _go_on_with(self, begun: Mapping[str, Any] | None) -> None:
        collector = self.collector
        if begun:
            shape = begun["action"].shape[: collector._carrier.ndim + 1]
            collector.begun = TensorDict(begun, shape).to(collector.storing_device)


def _paths(state: Mapping[str, Any]) -> set[tuple[str, ...]]:
    """Of everything in nested mappings."""
    return {
        (key, *path)
        for key, value in state.items()
        for path in (_paths(value) if isinstance(value, Mapping) else {()})
    }


class RandomState(GlobalRNGState):
    """TorchRL's state of the generators, with Python's 625 numbers as a tensor too.

    One by one they were most of the JSON of a checkpoint, and a tenth of the time it took.
    """

    def state_dict(self) -> dict[str, Any]:
        """Of Python, NumPy and torch."""
        state = super().state_dict()
        version, numbers, gauss = state["python"]
        return state | {"python": (version, torch.tensor(numbers), gauss)}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave, also of when the numbers stood one by one."""
        version, numbers, gauss = state_dict["python"]
        if isinstance(numbers, torch.Tensor):
            numbers = tuple(numbers.tolist())
        super().load_state_dict({**state_dict, "python": (version, numbers, gauss)})


def make_checkpoint(policy: nn.Module, collector_state: Any) -> Checkpoint:
    """The checkpoint to give to the trainer, with the parts it would not save itself.

    Args:
        policy: Saved apart from the loss, so that evaluation loads nothing else.
        collector_state: ``CollectorState``, or a collector whose own ``state_dict`` suffices.
    """
    checkpoint = SummedCheckpoint(policy=policy, collector=collector_state, rng=RandomState())
    return checkpoint.register_adapter(ReplayBuffer, BufferAdapter())


def latest_checkpoint(run_dir: Path) -> Path:
    """Path of the newest checkpoint of a run that is whole.

    Raises:
        FileNotFoundError: If there is none.
        DamagedError: If none is whole.
        RunFormatError: If it holds something that this project does not write.
    """
    latest = latest_of(run_dir)
    if latest is None:
        raise FileNotFoundError(
            f"{run_dir} holds no checkpoint below {CHECKPOINTS}/; is it a run directory, and did "
            "the run get as far as logging.checkpoint_interval?"
        )
    return latest


def trained_frames(path: Path) -> int:
    """Frames that had been collected when checkpoint ``path`` was written."""
    return int(Checkpoint.manifest(path)["metadata"]["collected_frames"])


def load_component(path: Path, name: str, module: nn.Module) -> None:
    """Loads one module of a checkpoint in place.

    Raises:
        ValueError: If the checkpoint is damaged, holds what this project does not write, or is of
            another architecture.
    """
    with _explained(path):
        Checkpoint(**{name: module}).load(path, components=[name], map_location="cpu")
    require_finite(module, path)


def load_trainer(path: Path, trainer: Trainer) -> None:
    """Restores a whole run in place.

    Raises:
        ValueError: If the checkpoint is damaged, holds what this project does not write, or is of
            another architecture.
    """
    # Not trainer.load_from_file: it also pushes the policy to the collector, in a form that a
    # collector of one process does not take; here both act with the module that was loaded.
    with _explained(path):
        trainer.checkpoint.load(path, map_location="cpu")
    require_finite(trainer.checkpoint.components["policy"], path)


def require_finite(module: nn.Module, path: Path) -> None:
    """Refuses weights that no arithmetic can go on with.

    Raises:
        DamagedError: If a number of ``module``, which was read from ``path``, is NaN or infinite.
    """
    for name, tensor in module.state_dict().items():
        if isinstance(tensor, torch.Tensor) and not torch.isfinite(tensor).all():
            raise DamagedError(
                f"{path}: {name} of its policy holds NaN or infinity: use an earlier checkpoint or "
                "train again"
            )


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    verify_checkpoint(path)
    try:
        yield
    except (OSError, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"Checkpoint {path} does not fit this configuration ({error}). Use the "
            "configuration that the run was made with (config.yaml beside its checkpoints)."
        ) from error
