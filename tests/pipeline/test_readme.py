"""The README's example of a variant of one's own is run as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from envs.demonstrations import sources
from losses import CosineWeight
from pipeline.trainer import Run

README = Path(__file__).parents[2] / "README.md"
SNIPPET = re.compile(r"<!-- snippet:compose -->\n```python\n(.*?)```", re.DOTALL)


def test_the_snippet_composes_and_trains(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    (snippet,) = SNIPPET.findall(README.read_text())
    assert len([line for line in snippet.splitlines() if line.strip()]) <= 15
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sources, "BUNDLED", demos)
    names = {"run_dir": tmp_path / "run"}
    exec(compile(snippet, str(README), "exec"), names)
    run = names["run"]
    assert isinstance(run, Run)
    assert run.trainer.collected_frames == run.config.collector.total_frames
    assert isinstance(run.trainer.loss_module.bc_weight, CosineWeight)
    assert run.trainer.loss_module.updates > 0
