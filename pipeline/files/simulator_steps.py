"""What a run costs in simulator steps, frames of training and all others; evaluations apart."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.files.run_files import RunDirectoryError, write_atomically
from pipeline.files.run_format import require_plain

SIMULATOR_STEPS = "simulator_steps.json"


@dataclass(frozen=True)
class ExtraSimulatorSteps:
    """Control steps that are not frames of training, summed over copies of the environment."""

    demonstrations: int = 0
    """Re-simulating and multiplying them; what was kept in a cache counts as when it was made."""
    rollouts: int = 0
    """Episodes of a BC model that join the demonstrations (ILD)."""

    @property
    def total(self) -> int:
        """All of them."""
        return self.demonstrations + self.rollouts

    def write(self, run_dir: Path) -> None:
        """Writes ``simulator_steps.json``, unless it says so already."""
        if (run_dir / SIMULATOR_STEPS).is_file() and self.read(run_dir) == self:
            return
        write_atomically(run_dir / SIMULATOR_STEPS, json.dumps(asdict(self), indent=2) + "\n")

    @classmethod
    def read(cls, run_dir: Path) -> ExtraSimulatorSteps | None:
        """What :meth:`write` wrote; None for runs and policies that are older than this file.

        Raises:
            RunDirectoryError: If it is damaged.
        """
        path = run_dir / SIMULATOR_STEPS
        if not path.is_file() and not path.is_symlink():
            return None
        try:
            found = json.loads(require_plain(path).read_text())
            return cls(**{key: int(value) for key, value in found.items()})
        except (ValueError, TypeError, AttributeError) as error:
            raise RunDirectoryError(f"{path} is damaged ({error}); restore or remove it") from error
