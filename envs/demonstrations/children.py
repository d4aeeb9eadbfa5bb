"""Reading what may crash the reader in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

from envs.demonstrations import limits
from envs.demonstrations.errors import DemonstrationError

_HARMFUL = "It is damaged or made to do harm: get it from its publisher"


def run_child(script: str, path: Path, *arguments: int, output: IO[bytes] | None = None) -> int:
    """Run ``script PATH BYTES SECONDS ARGUMENTS...`` with limited memory and time.

    Args:
        script: file that needs NumPy and h5py at most, so that it starts in a moment.
        path: what it reads.
        arguments: further numbers for it.
        output: takes its standard output; None drops it.

    Returns:
        Its exit code, not negative.

    Raises:
        DemonstrationError: a signal ended it, or its time was up.
    """
    size = limits.CHILD_BYTES + 10 * path.stat().st_size
    numbers = (size, int(limits.CHILD_SECONDS) + 1, *arguments)
    # -P: the folder of the script must not shadow anybody's modules.
    command = [sys.executable, "-P", script, str(path.absolute()), *map(str, numbers)]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL if output is None else output,
            stderr=subprocess.DEVNULL,
            timeout=limits.CHILD_SECONDS,
            check=False,
            # Threads of numpy's library would take address space, and nothing is multiplied.
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired as error:
        raise DemonstrationError(
            path, f"is not read within {limits.CHILD_SECONDS:.0f} s", _HARMFUL
        ) from error
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        raise DemonstrationError(path, f"ends the process that reads it ({name})", _HARMFUL)
    return done.returncode
