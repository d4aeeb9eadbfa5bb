"""One name for every source."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from envs.demonstrations import DemonstrationError, open_source, write_recording
from envs.door.demos import SCHEMA
from tests.envs.demonstrations.helpers import raw_demo, still_episode, write_pickle


def test_a_folder_holds_files_of_any_kind(tmp_path: Path) -> None:
    write_recording(tmp_path / "b.h5", [still_episode(7)], {})
    write_pickle(tmp_path / "a.pkl", [raw_demo(0), raw_demo(1)])
    (tmp_path / "notes.txt").write_text("not a demonstration")
    names = [
        (e.provenance.source, e.provenance.episode) for e in open_source(tmp_path).load(SCHEMA)
    ]
    assert names == [("a.pkl", 0), ("a.pkl", 1), ("synthetic", 7)]


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(DemonstrationError, match="holds no demonstration files"):
        open_source(tmp_path).load(SCHEMA)


def test_a_missing_path_is_told_in_a_short_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DemonstrationError) as caught:
        open_source("absent.pickle")
    assert str(caught.value) == (
        f"absent.pickle: does not exist (looked for in {tmp_path}). "
        "What can be named: docs/reference/demonstrations.md"
    )


def test_an_unknown_suffix(tmp_path: Path) -> None:
    (tmp_path / "demos.csv").write_text("1,2")
    with pytest.raises(
        DemonstrationError, match=r"unknown suffix '.csv'.*bundled, .*DAPG pickle.*minari"
    ):
        open_source(tmp_path / "demos.csv")


def test_bundled_is_a_recording(tmp_path: Path) -> None:
    write_recording(tmp_path / "door.h5", [still_episode(4)], {})
    source = open_source("bundled")
    assert source.name == "bundled"
    schema = dataclasses.replace(SCHEMA, bundled=tmp_path / "door.h5")
    assert [e.provenance.episode for e in source.load(schema)] == [4]
    nothing = dataclasses.replace(SCHEMA, bundled=None)
    with pytest.raises(DemonstrationError, match="no demonstrations come with the Adroit door"):
        source.load(nothing)
