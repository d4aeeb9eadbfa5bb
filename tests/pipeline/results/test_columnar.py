"""One file of published runs: what goes in comes out."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.results import columnar

RUNS = {
    ("b", 1): {
        "x": 1,
        "made_from": {"task": "t"},
        "curve": {"frames": [0, 5], "stages": [{"a": 1.0}, {}]},
    },
    ("a", 0): {"x": None, "y": 0.5, "curve": {"frames": [], "stages": [{"b": 0.0}]}, "alarms": []},
}  # fmt: skip


def test_runs_of_different_tasks_come_back_as_they_were(tmp_path: Path):
    path = tmp_path / "runs.parquet"
    columnar.save(("row", "seed"), RUNS, path)
    assert columnar.load(("row", "seed"), path) == RUNS
    assert list(columnar.load(("row", "seed"), path)) == [("a", 0), ("b", 1)]


def test_figures_and_curves_are_columns_that_others_read(tmp_path: Path):
    columnar.save(("row", "seed"), RUNS, tmp_path / "runs.parquet")
    table = pq.read_table(tmp_path / "runs.parquet", columns=["row", "x", "curve.frames"])
    assert table.to_pylist()[1] == {"row": "b", "x": 1, "curve.frames": [0, 5]}


@pytest.mark.parametrize("content", [b"", b"PAR1 and no more", b"{}"])
def test_a_damaged_file_is_named(content: bytes, tmp_path: Path):
    path = tmp_path / "runs.parquet"
    path.write_bytes(content)
    with pytest.raises(
        RunDirectoryError, match=r"runs\.parquet is damaged, or no file of publ.*re"
    ):
        columnar.load(("row", "seed"), path)


def test_a_file_with_other_keys_is_named(tmp_path: Path):
    columnar.save(("row", "seed"), RUNS, tmp_path / "runs.parquet")
    with pytest.raises(RunDirectoryError, match=r"runs\.parquet is damaged.*'task'"):
        columnar.load(("task", "seed"), tmp_path / "runs.parquet")
