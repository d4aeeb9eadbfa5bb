"""How a checkpoint gets into a run's directory: written, sealed, named; and the oldest goes.

Written is what training goes on from as soon as its copy is complete. Sealed is what makes it
trustworthy, its checksums and that the disk has all of it: that is done beside the training.
"""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointRotation

from pipeline.files.background import BackgroundWork
from pipeline.files.run_files import CHECKPOINTS
from pipeline.files.run_format import SUMMED
from pipeline.files.sums import SUMS, replace_folder, write_sums


class SummedCheckpoint(Checkpoint):
    """TorchRL's checkpoint, with the checksums of its files and on the disk before it has its name.

    A process that is killed, or a machine that loses power, leaves the whole checkpoint or the one
    before.
    """

    def save(
        self, path: str | Path, *, metadata: Mapping[str, Any] | None = None, **options: Any
    ) -> Path:
        """As TorchRL's."""
        destination = Path(path)
        seal(self.write(destination, metadata=metadata, **options), destination)
        return destination

    def write(
        self, destination: Path, *, metadata: Mapping[str, Any] | None = None, **options: Any
    ) -> Path:
        """Copies everything into files, for :func:`seal`; what it was copied from may change then.

        Returns:
            Their folder, beside ``destination``. It is hidden: whoever looks for checkpoints passes
            it over.
        """
        stage = destination.with_name(f".{destination.name}.{uuid.uuid4().hex}")
        return super().save(stage, metadata={**(metadata or {}), SUMMED: SUMS}, **options)


def seal(stage: Path, destination: Path) -> None:
    """Makes the checkpoint ``destination`` of what was written into ``stage``, or removes that.

    Raises:
        OSError: If the disk does not take it; what was at ``destination`` is there as before.
    """
    try:
        write_sums(stage)
        replace_folder(stage, destination)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


class SealedRotation(CheckpointRotation):
    """Keeps the newest checkpoints, each of which is sealed beside the training.

    Two are never under way at once, and an old one goes when the new one has its name: there are at
    least as many as are to be kept, whenever the process ends.

    Args:
        directory: Of the checkpoints.
        keep_last: How many.
    """

    def __init__(self, directory: Path, *, keep_last: int) -> None:
        super().__init__(directory, keep_last=keep_last)
        self.sealing = BackgroundWork()

    def save(
        self,
        checkpoint: SummedCheckpoint,
        *,
        step: int,
        metadata: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> Path:
        """Returns the path that the checkpoint has when ``sealing`` has settled.

        Raises:
            OSError: If it cannot be written, or the one before could not be sealed.
        """
        self.sealing.settle()
        destination = self._checkpoint_path(step, checkpoint.format)
        stage = checkpoint.write(destination, metadata=metadata, **options)

        def finish() -> None:
            seal(stage, destination)
            self.prune()

        self.sealing.begin(finish)
        return destination


def make_rotation(run_dir: Path, keep: int) -> SealedRotation:
    """Keeps the ``keep`` newest checkpoints below ``run_dir / "checkpoints"``.

    What a killed process left there half made is removed.
    """
    folder = run_dir / CHECKPOINTS
    if folder.is_dir() and not folder.is_symlink():
        for left in folder.glob(".*checkpoint-*"):
            shutil.rmtree(left, ignore_errors=True)
    return SealedRotation(folder, keep_last=keep)
