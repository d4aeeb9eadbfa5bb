"""A file is there whole or not at all, whoever writes it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from envs.whole_files import whole_file, whole_set


def test_the_file_takes_its_place_when_the_block_ends(tmp_path: Path):
    path = tmp_path / "x.json"
    path.write_text("old")
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_block_that_fails_leaves_what_was_there(tmp_path: Path):
    path = tmp_path / "x.json"
    path.write_text("old")

    def fail() -> None:
        with whole_file(path) as temporary:
            temporary.write_text("half")
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_others_may_read_it_as_the_umask_says(tmp_path: Path):
    before = os.umask(0o027)
    try:
        with whole_file(tmp_path / "x") as temporary:
            temporary.write_text("")
    finally:
        os.umask(before)
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o640


def test_it_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch):
    path, there = tmp_path / "x", []
    monkeypatch.setattr(os, "fsync", lambda _handle: there.append(path.exists()))
    with whole_file(path) as temporary:
        temporary.write_text("x")
    assert there == [False]


@pytest.mark.parametrize(
    ("raised", "named"),
    [
        (OSError(errno.ENOSPC, "No space left"), "x"),  # of a write, which names no file
        (FileNotFoundError(errno.ENOENT, "No such file", "elsewhere"), "elsewhere"),
    ],
)
def test_an_error_names_the_file_that_was_asked_for(raised: OSError, named: str, tmp_path: Path):
    with pytest.raises(type(raised)) as error, whole_file(tmp_path / "x"):
        raise raised
    assert Path(error.value.filename).name == named
    assert error.value.errno == raised.errno


def test_an_error_of_the_temporary_file_names_the_file(tmp_path: Path):
    with pytest.raises(FileNotFoundError) as error, whole_file(tmp_path / "no" / "x") as temporary:
        temporary.write_text("")
    assert error.value.filename == str(tmp_path / "no" / "x")


def test_a_library_that_goes_by_the_ending_gets_it(tmp_path: Path):
    with whole_file(tmp_path / "x.mp4", ".mp4") as temporary:
        assert temporary.suffix == ".mp4"
        temporary.write_text("")


def test_a_set_comes_into_its_folder_together(tmp_path: Path):
    folder = tmp_path / "set"
    with whole_set(folder) as made:
        (made / "a").mkdir()
        (made / "a" / "x").write_text("new")
        assert list(folder.rglob("x")) == [made / "a" / "x"]
    (folder / "a" / "other").write_text("stays")
    with whole_set(folder) as made:
        (made / "a").mkdir()
        (made / "a" / "x").write_text("newer")
    found = {path.name: path.read_text() for path in folder.rglob("*") if path.is_file()}
    assert found == {"x": "newer", "other": "stays"}
    assert list(folder.iterdir()) == [folder / "a"]


def test_a_set_that_fails_half_way_changes_nothing(tmp_path: Path):
    (tmp_path / "x").write_text("old")

    def fail() -> None:
        with whole_set(tmp_path) as made:
            (made / "x").write_text("new")
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ["x"]
    assert (tmp_path / "x").read_text() == "old"
