"""`make rows`, with something in place of Python that fails for one of the seeds."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

FAKE = """#!/bin/sh
case "$*" in
  *seed1*) echo "error: of seed 1" >&2; exit 1;;
  *pipeline.cli*) for last; do :; done; echo '{}' > "$(echo "$*" | sed 's/.* eval //; s/ env.*//')/evaluation.json";;
  *) run=$(echo "$*" | sed 's/.*run_dir=//; s/ .*//'); mkdir -p "$run";;
esac
"""  # noqa: E501 - one command


def test_a_seed_that_fails_is_told_at_the_end_and_the_others_run(tmp_path: Path):
    python = tmp_path / "venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(FAKE)
    python.chmod(0o755)
    stamp = tmp_path / "venv/.installed-dev"
    stamp.touch()
    os.utime(stamp, (time.time() + 3600,) * 2)  # newer than what it is made from
    runs = tmp_path / "rows"
    done = subprocess.run(
        ["make", "rows", f"VENV={tmp_path / 'venv'}", "EXTRAS=dev", f"ROW_RUNS={runs}",
         "ROWS=sac", "SEEDS=0 1 2"],
        capture_output=True, text=True, check=False, env={"PATH": os.environ["PATH"]},
    )  # fmt: skip
    assert done.returncode != 0
    assert [path.parent.name for path in sorted(runs.glob("*/*/evaluation.json"))] == [
        "seed0",
        "seed2",
    ]
    assert f"make rows: no {runs}/sac/seed1/evaluation.json" in done.stderr
    assert "seed0/evaluation" not in done.stderr
