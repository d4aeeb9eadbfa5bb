"""Configurations and evaluations that are damaged, or made to do harm, are told in one line."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from pipeline.files.run_files import (
    CONFIG,
    EVALUATION,
    SUM,
    TEXT_BYTES,
    RunDirectoryError,
    write_atomically,
)
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import load_evaluation, save_evaluation
from pipeline.run_dir import load_recipe, save_recipe

BOMB = "\n".join(
    ["a0: &a0 [lol]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30))]
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (BOMB, "holds an alias"),
        ("a: " + "[" * 100_000, "is nested deeper"),
        ("seed: 0\n" * (TEXT_BYTES // 8 + 1), "is larger than any"),
        ("seed: [\n\n", "is damaged"),
        ("seed: 2001-99-99", "is damaged"),
        ("", "holds no recipe"),
        (b"seed: \xff", "is damaged"),
    ],
)
def test_a_configuration_that_is_none_is_one_line(text: str | bytes, told: str, tmp_path: Path):
    path = tmp_path / CONFIG
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(RunDirectoryError, match=told) as refused:
        load_recipe(tmp_path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_configuration_that_was_changed_is_refused_until_its_sum_goes(tmp_path: Path):
    path = tmp_path / CONFIG
    save_recipe(tmp_path, Recipe(seed=3))
    assert load_recipe(tmp_path).seed == 3
    text = path.read_text()
    path.write_text(text.replace("seed: 3\n", "seed: 7\n"))
    with pytest.raises(RunDirectoryError, match=rf"{path} is not as it was written: .*first line"):
        load_recipe(tmp_path)
    path.write_text(path.read_text().partition("\n")[2])
    assert load_recipe(tmp_path).seed == 7
    path.write_text(text[: len(text) // 2])  # without its end it would mean the defaults
    with pytest.raises(RunDirectoryError, match="is not as it was written"):
        load_recipe(tmp_path)
    assert text.startswith(SUM)


EVALUATED = {
    "episodes": 10,
    "return_mean": 12.25,
    "stages": {"open": 0.1},
    "made_from": {"run": "runs/x", "variant": "bc", "seed": 3, "nothing": None},
}


def test_an_evaluation_is_read_as_it_was_written(tmp_path: Path):
    save_evaluation(tmp_path / EVALUATION, EVALUATED)
    assert load_evaluation(tmp_path).content == EVALUATED
    (tmp_path / EVALUATION).write_text(json.dumps(EVALUATED))  # as before there were checksums
    assert load_evaluation(tmp_path).content == EVALUATED


def test_another_figure_is_refused(tmp_path: Path):
    path = tmp_path / EVALUATION
    save_evaluation(path, EVALUATED)
    path.write_text(path.read_text().replace("12.25", "13.25"))
    with pytest.raises(RunDirectoryError, match=rf"{path} is not as it was written: .*make eval"):
        load_evaluation(tmp_path)


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[]", b"{}", b"\xff", b'{"made_from": 3}', b"[" * 100_000]
)
def test_what_is_no_evaluation_is_one_line(text: bytes, tmp_path: Path):
    (tmp_path / EVALUATION).write_bytes(text)
    with pytest.raises(RunDirectoryError, match="is not an evaluation") as refused:
        load_evaluation(tmp_path)
    assert str(tmp_path / EVALUATION) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_text_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path, events = tmp_path / "text", []
    path.write_text("old")
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda handle: (events.append("disk"), fsync(handle))[1])
    monkeypatch.setattr(Path, "replace", lambda a, b: (events.append(b), replace(a, b))[1])
    write_atomically(path, "new")
    assert events == ["disk", path]
    assert path.read_text() == "new"


def test_a_text_that_cannot_be_written_leaves_the_old_one_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "text"
    path.write_text("old")

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as failed:
        write_atomically(path, "new")
    assert failed.value.filename == str(path), "a write alone says no name"
    assert [one.read_text() for one in tmp_path.iterdir()] == ["old"]
