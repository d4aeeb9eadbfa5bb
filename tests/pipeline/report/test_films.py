from __future__ import annotations

import base64
import re
from pathlib import Path

import pytest

from pipeline.report import films as module
from pipeline.report.build import build_report
from pipeline.report.films import films
from pipeline.results.grouping import group
from pipeline.results.reading import read_runs
from tests.pipeline.report.making import make_run


def section_of(folder: Path):
    return films(group(read_runs([folder])))


def test_films_in_the_run_directories_are_in_the_page(tmp_path: Path):
    run = make_run(tmp_path / "rows" / "a" / "seed0")
    (run / "video.mp4").write_bytes(b"moving")
    (run / "worst.gif").write_bytes(b"jerky")
    (run / ".half.1.mp4").write_bytes(b"half")
    page = build_report(group(read_runs([run]))).html()
    found = re.findall(r'<(video|img) class="clip" src="data:([^;]+);base64,([^"]+)"', page)
    assert [(tag, kind, base64.b64decode(content)) for tag, kind, content in found] == [
        ("video", "video/mp4", b"moving"),
        ("img", "image/gif", b"jerky"),
    ]
    assert "a/seed0: video.mp4" in page


def test_what_is_too_long_or_missing_says_how_to_make_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module, "MOST_BYTES", 10)
    monkeypatch.setattr(module, "TOTAL_BYTES", 15)
    for name, size in (("a", 11), ("b", 10), ("c", 6), ("d", 5), ("e", None)):
        run = make_run(tmp_path / name, seed=ord(name))
        if size is not None:
            (run / "video.mp4").write_bytes(b"x" * size)
    found = section_of(tmp_path)
    assert [clip.title.split("/")[-1] for clip in found.clips] == ["b: video.mp4", "d: video.mp4"]
    told = "\n".join(found.absent)
    assert re.search(r"/a/video\.mp4: more than .*make video RUN=\.\.\. EPISODES=1", told)
    assert re.search(r"/c/video\.mp4: the films before it fill", told)
    assert re.search(r"/e: no film in the run's folder; make one with: make video RUN=", told)


def test_a_link_is_not_followed(tmp_path: Path):
    run = make_run(tmp_path / "a")
    (tmp_path / "elsewhere").write_bytes(b"private")
    (run / "video.mp4").symlink_to(tmp_path / "elsewhere")
    assert not section_of(tmp_path / "a").clips
