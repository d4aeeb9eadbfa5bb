"""A disk that is full: looked at before a checkpoint, and said in one line."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Mapping
from functools import wraps
from pathlib import Path
from typing import Any

from torch import Tensor
from torchrl.data import ReplayBuffer
from torchrl.trainers import Trainer

from pipeline.files.background import BackgroundWork
from pipeline.files.full_disk import is_full, where_and_what

SPARE = 2**18
"""Bytes of descriptions."""
BLOCK = 2**13
"""Bytes that a tensor's file takes at most besides the tensor: the rest of its last block, its name
and its part of a description."""


def with_room(trainer: Trainer, run_dir: Path, sealing: BackgroundWork) -> None:
    """Lets ``trainer`` save nothing that the disk has no room for.

    A checkpoint is written through memory maps, and a write to one on a full disk is no error that
    could be caught: the system ends the process (SIGBUS). What ``sealing`` is at work on is done
    before, since an old checkpoint gives its room back then.
    """
    save = trainer._save_trainer

    @wraps(save)
    def guarded() -> None:
        sealing.settle()
        components = trainer._sync_checkpoint_components().components
        needed = SPARE + sum(size_of(component) for component in components.values())
        free = shutil.disk_usage(run_dir).free
        if free < needed:
            why = (
                f"a checkpoint takes {needed / 2**20:.1f} MiB, of which {free / 2**20:.1f} are free"
            )
            raise OSError(errno.ENOSPC, why, str(run_dir))
        if trainer.logger is not None:
            trainer.logger.flush()  # rows that the checkpoint covers are never written again
        save()

    trainer._save_trainer = guarded


def size_of(component: Any) -> int:
    """Bytes of the tensors that a checkpoint holds of ``component``."""
    if isinstance(component, ReplayBuffer):
        return _bytes(component[:].to_dict()) if len(component) else 0
    return _bytes(component.state_dict())


def training_stopped_by(error: OSError) -> str:
    """What a training ends with, in one line: what went wrong at which file, and the remedy."""
    said = where_and_what(error)
    if is_full(error):
        return (
            f"{said}: no space left. The last checkpoint is as it was: free some space and go on "
            "with RESUME=<run directory>."
        )
    return f"{said}. The last checkpoint is as it was."


def _bytes(state: Any) -> int:
    if isinstance(state, Tensor):
        return state.numel() * state.element_size() + BLOCK
    if isinstance(state, Mapping):
        return sum(_bytes(entry) for entry in state.values())
    if isinstance(state, (list, tuple)):
        return sum(_bytes(entry) for entry in state)
    return 8
