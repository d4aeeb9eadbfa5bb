"""A run directory belongs to one process at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.files.run_lock import LOCK, lock_run


def test_a_directory_that_cannot_be_locked_is_told(tmp_path: Path):
    (tmp_path / LOCK).mkdir()
    with pytest.raises(RunDirectoryError, match=r"Run directory .* cannot be written \(Is a dir"):
        lock_run(tmp_path)
