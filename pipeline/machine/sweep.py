"""The jobs of a sweep: one that fails is told at the end, and the others run."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

NOTES: Final = "BCSAC_SWEEP_NOTES"
"""Environment variable, which launchers hand on to their processes: a file, a line for each job."""


@contextmanager
def sweep() -> Iterator[None]:
    """Gathers how the jobs inside end, in whatever processes they run.

    Raises:
        SystemExit: With code 1 after the last one, if one failed; the message lists them.
    """
    with tempfile.TemporaryDirectory() as folder:
        notes = Path(folder) / "jobs.jsonl"
        os.environ[NOTES] = str(notes)
        try:
            yield
        finally:
            del os.environ[NOTES]
        jobs = (
            [json.loads(line) for line in notes.read_text().splitlines()] if notes.exists() else []
        )
    failed = [job for job in jobs if job["failed"] is not None]
    if failed:
        told = "".join(f"\n  {' '.join(job['job'])}: {job['failed']}" for job in failed)
        sys.exit(f"error: {len(failed)} of {len(jobs)} jobs failed:{told}")


def note(job: Sequence[str], failed: str | None) -> None:
    """Notes how a job of a sweep ended.

    Args:
        job: Its overrides.
        failed: Why it failed; None if it did not.
    """
    # One write of a short line: jobs that run side by side do not mix theirs.
    with Path(os.environ[NOTES]).open("a") as file:
        file.write(json.dumps({"job": list(job), "failed": failed}) + "\n")
