"""A folder takes another's place: there is one of the two at every moment, where the system can."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.files import sums


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    made, destination = tmp_path / ".made", tmp_path / "checkpoint-1"
    for folder in (made, destination):
        folder.mkdir()
        (folder / "weights").write_text(folder.name)
    return made, destination


def test_the_old_one_never_leaves_its_name(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
):
    """A kill between two renames would leave a run whose only checkpoint it is with none."""
    if sums._renameat2 is None:
        pytest.skip("the C library of this system cannot exchange two names")
    made, destination = folders
    exchange, seen = sums._renameat2, []

    def watched(*arguments: int | bytes) -> int:
        seen.append((destination / "weights").read_text())
        code = exchange(*arguments)
        seen.append((destination / "weights").read_text())
        return code

    monkeypatch.setattr(sums, "_renameat2", watched)
    monkeypatch.setattr(Path, "rename", lambda *_: pytest.fail("a name was free for a moment"))
    sums.replace_folder(made, destination)
    assert seen == ["checkpoint-1", ".made"]
    assert [path.name for path in destination.parent.iterdir()] == ["checkpoint-1"]


@pytest.mark.parametrize("exchange", [None, lambda *_: -1], ids=["no call", "not on this disk"])
def test_what_cannot_be_exchanged_is_replaced_all_the_same(
    exchange: object, folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
):
    made, destination = folders
    monkeypatch.setattr(sums, "_renameat2", exchange)
    sums.replace_folder(made, destination)
    assert (destination / "weights").read_text() == ".made"
    assert [path.name for path in destination.parent.iterdir()] == ["checkpoint-1"]
