"""What the README says: its example runs as it stands, its results are the published ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from envs.demonstrations import sources
from losses import CosineWeight
from pipeline.results.rows import load_published
from pipeline.results.tables import render_summary
from pipeline.trainer import Run

README = Path(__file__).parents[2] / "README.md"
RESULTS = README.parent / "docs" / "results"
TABLE = re.compile(r"<!-- results: docs/results/summary\.md -->\n(.*?)<!-- end -->", re.DOTALL)
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


def test_the_table_of_results_is_the_published_one():
    """`make results` writes summary.md; it goes between the README's marks as it is."""
    (shown,) = TABLE.findall(README.read_text())
    assert shown.strip() == (RESULTS / "summary.md").read_text().strip()


def test_the_published_summary_is_that_of_the_published_seeds():
    lines = (RESULTS / "summary.md").read_text().splitlines()
    computed = render_summary(load_published(RESULTS)).splitlines()
    assert sorted(line.split() for line in lines) == sorted(line.split() for line in computed)
