"""Rows over frames, read from files that may hold anything, and cut back."""

from __future__ import annotations

from pathlib import Path

import pytest
from torchrl.record.loggers import get_logger

from pipeline.files.curves import count_no_rows, cut_back, in_order, last_wall_s, read_lines


def test_rows_are_read_by_frames_whatever_a_curve_holds(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    path = tmp_path / "learning_curve.jsonl"
    path.write_text(
        '{"frames": 40, "a": 1}\n\n{"frames": 20, "a": 2}\n[3]\n{"a": 4}\n{"frames": 40, "a": 5}\n'
        '{"frames": NaN}\n{"frames": 60, "a'
    )
    assert read_lines(path) == [{"frames": 20, "a": 2}, {"frames": 40, "a": 5}]
    assert "line 8 is no row" in caplog.text
    assert read_lines(tmp_path / "nowhere") == []
    assert in_order([{"frames": 3.0}, {"frames": 1}, {}]) == [{"frames": 1}, {"frames": 3.0}]


HOSTILE = (
    '{"frames": 1' + "0" * 400 + "}",
    '{"frames": 30, "wall_s": 1' + "0" * 400 + "}",
    '{"frames": 30, "stages": {"near": -1' + "0" * 400 + "}}",
    '{"frames": 1e999}',
    "[" * 100_000,
)
"""Lines that are no rows, though most of them are JSON."""


@pytest.mark.parametrize("line", HOSTILE, ids=lambda line: line[:30])
def test_a_line_that_holds_no_usable_numbers_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, line: str
):
    path = tmp_path / "learning_curve.jsonl"
    path.write_text('{"frames": 20, "wall_s": 2.5}\n' + line + '\n{"frames": 40}\n')
    assert [row["frames"] for row in read_lines(path)] == [20, 40]
    assert "line 2 is no row" in caplog.text
    assert count_no_rows(path) == 1
    assert last_wall_s(tmp_path) == 2.5
    cut_back(tmp_path, 20)
    assert path.read_text() == '{"frames": 20, "wall_s": 2.5}\n'


def test_an_infinite_wall_time_is_none(tmp_path: Path):
    rows = '{"frames": 20, "wall_s": 2.5}\n{"frames": 40, "wall_s": 1e999}\n'
    (tmp_path / "learning_curve.jsonl").write_text(rows)
    assert last_wall_s(tmp_path) == 2.5


def test_a_half_written_line_of_a_csv_file_is_dropped(tmp_path: Path):
    """As long as its frames are whole it looks like a row, with another value."""
    path = tmp_path / "logs" / "csv" / "scalars" / "x.csv"
    path.parent.mkdir(parents=True)
    path.write_text("20,1.5\n40,2.25\n40,2.")
    cut_back(tmp_path, 40)
    assert path.read_text() == "20,1.5\n40,2.25\n"


def test_cutting_leaves_alone_what_is_complete(tmp_path: Path):
    (tmp_path / "learning_curve.jsonl").write_text('{"frames": 40}\n')
    logger = get_logger("csv", str(tmp_path / "logs"), "csv")
    logger.log_scalar("x", 1.0, step=40)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    cut_back(tmp_path, 40)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
