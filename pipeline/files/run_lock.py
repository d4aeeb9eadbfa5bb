"""One process at a time writes to a run directory."""

from __future__ import annotations

from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.files.run_files import RunDirectoryError

LOCK = ".lock"
"""In the run directory. The operating system frees it with its process, however that ends."""


def lock_run(run_dir: Path) -> FileLock:
    """Locks a run directory that exists for this process, which may do so more than once.

    Raises:
        RunDirectoryError: If another process trains in it, or it cannot be written.
    """
    lock = FileLock(run_dir / LOCK, timeout=0, is_singleton=True)
    try:
        lock.acquire()
    except Timeout as error:
        raise RunDirectoryError(
            f"Run directory {run_dir} is in use: another process trains in it (it holds "
            f"{run_dir / LOCK}). Wait until it is done, or stop it."
        ) from error
    except OSError as error:
        raise RunDirectoryError(
            f"Run directory {run_dir} cannot be written ({error.strerror})."
        ) from error
    return lock


def is_locked(run_dir: Path) -> bool:
    """Whether another process trains in it."""
    try:
        lock_run(run_dir).release()
    except RunDirectoryError:
        return True
    return False
