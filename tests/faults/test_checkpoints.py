"""A damaged checkpoint is never read: the one before it is, or a line says what to do."""

from __future__ import annotations

import ctypes
import errno
import json
import logging
import os
import shutil
from pathlib import Path
from random import Random

import pytest
import torch
from tensordict import TensorDict

from envs.door.definition import TASK
from pipeline.build import build_run
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files import rotation, sums
from pipeline.files.checkpoint import latest_checkpoint, load_component
from pipeline.files.rotation import SummedCheckpoint
from pipeline.files.run_format import MANIFEST, SUMMED
from pipeline.files.sums import SUMS, DamagedError, verify_sums, write_sums
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from tests.faults.damaging import KINDS, Damage, append, delete, empty, flip, link, truncate
from tests.pipeline.resuming import differences
from tests.pipeline.toys import built, tiny_config

FRAMES = (20, 40)


def checkpoint(run_dir: Path, frames: int) -> Path:
    return run_dir / "checkpoints" / f"checkpoint-{frames:012d}"


def tensor_of(path: Path, component: str = "policy", column: str = "state/*.memmap") -> Path:
    return next(path.glob(f"components/*-{component}/{column}"))


def contents(folder: Path) -> dict[Path, tuple[int, bytes]]:
    return {
        path: (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file()
    }


def unsummed(path: Path) -> None:
    """As checkpoints were before they had checksums."""
    manifest = json.loads((path / MANIFEST).read_text())
    del manifest["metadata"][SUMMED]
    (path / MANIFEST).write_text(json.dumps(manifest))
    (path / SUMS).unlink()


@pytest.mark.parametrize("kind", [truncate, empty, flip, delete, append])
@pytest.mark.parametrize("component", ["policy", "trainer_module.main_buffer"])
def test_the_one_before_a_damaged_newest_one_serves(
    kind: Damage, component: str, run_dir: Path, caplog: pytest.LogCaptureFixture
):
    column = "state/*.memmap" if component == "policy" else "rows/observation.memmap"
    bad = tensor_of(checkpoint(run_dir, 40), component, column)
    kind(bad, Random(0))
    before = contents(run_dir)
    with caplog.at_level(logging.WARNING):
        made_from = evaluate_run(run_dir, episodes=1)["made_from"]
    assert (made_from["checkpoint"], made_from["frames"]) == ("checkpoint-000000000020", 20)
    (told,) = [r.getMessage() for r in caplog.records if "is used in its place" in r.getMessage()]
    assert str(bad) in told
    assert "checkpoint-000000000020 is used" in told
    assert contents(run_dir) == before, "reading changed it"


def test_a_run_resumes_from_the_one_before_and_ends_the_same(run_dir: Path, finished: Path):
    flip(tensor_of(checkpoint(run_dir, 40), "trainer_module.optimization_stepper"), Random(1))
    run = build_run(load_recipe(run_dir), run_dir, resume=True)
    assert run.trainer.collected_frames == 20
    run.train()
    recipe = load_recipe(finished)
    expected, _ = load_policy(recipe, TASK, finished)
    found, origin = load_policy(recipe, TASK, run_dir)
    assert origin.frames == 40
    assert differences(found.state_dict(), expected.state_dict()) == []


@pytest.mark.parametrize("kind", [truncate, empty, flip, delete, append])
def test_if_none_is_whole_the_error_names_the_file(kind: Damage, run_dir: Path):
    for frames in FRAMES:
        kind(tensor_of(checkpoint(run_dir, frames)), Random(0))
    bad = tensor_of(checkpoint(run_dir, 40)) if kind is not delete else checkpoint(run_dir, 40)
    before = contents(run_dir)
    for read in (
        lambda: evaluate_run(run_dir, episodes=1),
        lambda: build_run(load_recipe(run_dir), run_dir, resume=True),
    ):
        with pytest.raises(DamagedError, match=r"no checkpoint of .* is whole: restore") as refused:
            read()
        assert str(bad.name if kind is not delete else ".memmap") in str(refused.value)
        assert "\n" not in str(refused.value)
    assert contents(run_dir) == before


def test_a_checkpoint_without_a_manifest_is_damaged(run_dir: Path):
    (checkpoint(run_dir, 40) / MANIFEST).unlink()
    assert latest_checkpoint(run_dir).name.endswith("20")


def test_checksums_that_were_promised_are_missed(run_dir: Path):
    (checkpoint(run_dir, 40) / SUMS).unlink()
    assert latest_checkpoint(run_dir).name.endswith("20")


def missing_column(path: Path) -> None:
    """Also of the description of its folder."""
    column = tensor_of(path, "trainer_module.main_buffer", "rows/action.memmap")
    column.unlink()
    meta = column.with_name("meta.json")
    described = json.loads(meta.read_text())
    del described["action"]
    meta.write_text(json.dumps(described))


def emptied_buffer(path: Path) -> None:
    (rows,) = path.glob("components/*-trainer_module.main_buffer/rows")
    shutil.rmtree(rows)


def shortened(path: Path) -> None:
    truncate(tensor_of(path), Random(0))


def emptied(path: Path) -> None:
    empty(tensor_of(path), Random(0))


def lengthened(path: Path) -> None:
    append(tensor_of(path), Random(0))


def no_description(path: Path) -> None:
    (tensor_of(path).with_name("meta.json")).unlink()


@pytest.mark.parametrize(
    "harm", [missing_column, emptied_buffer, shortened, emptied, lengthened, no_description]
)
def test_without_checksums_sizes_and_lists_are_held_against_it(harm, run_dir: Path):
    for frames in FRAMES:
        unsummed(checkpoint(run_dir, frames))
    assert evaluate_run(run_dir, episodes=1)["made_from"]["frames"] == 40
    harm(checkpoint(run_dir, 40))
    before = contents(run_dir)
    assert latest_checkpoint(run_dir).name.endswith("20")
    assert contents(run_dir) == before


def test_weights_that_are_nan_are_refused(run_dir: Path):
    path = checkpoint(run_dir, 40)
    state = TensorDict.load_memmap(tensor_of(path).parent)
    state["tensor_00000002"].fill_(float("nan"))
    write_sums(path)  # a run that went wrong wrote them so
    for read in (
        lambda: evaluate_run(run_dir, episodes=1),
        lambda: build_run(load_recipe(run_dir), run_dir, resume=True),
    ):
        with pytest.raises(DamagedError, match=rf"{path}: .*weight of its policy holds NaN"):
            read()


def test_a_save_that_fails_half_way_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    module = torch.nn.Linear(1, 1)
    SummedCheckpoint(policy=module).save(tmp_path / "saved")
    before = contents(tmp_path)

    def full(_folder: Path) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(rotation, "write_sums", full)
    with pytest.raises(OSError, match="no space"):
        SummedCheckpoint(policy=torch.nn.Linear(1, 1)).save(tmp_path / "saved")
    assert contents(tmp_path) == before


def watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is asked of the disk: paths, "rename", and "all of" the files below a folder."""
    events: list[str] = []
    fsync, rename, whole = os.fsync, Path.rename, sums._syncfs

    def at(handle: int) -> str:
        return os.readlink(f"/proc/self/fd/{handle}")

    monkeypatch.setattr(os, "fsync", lambda f: (events.append(at(f)), fsync(f))[1])
    monkeypatch.setattr(Path, "rename", lambda a, b: (events.append("rename"), rename(a, b))[1])

    def all_of(handle: int) -> int:
        held = sorted(path.name for path in Path(at(handle)).rglob("*") if path.is_file())
        events.append(f"all of {' '.join(held)}")
        return whole(handle)

    if whole is not None:
        monkeypatch.setattr(sums, "_syncfs", all_of)
    return events


@pytest.mark.skipif(sums._syncfs is None, reason="this system writes through file by file")
def test_a_checkpoint_has_its_name_when_all_of_it_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    events = watched(monkeypatch)
    SummedCheckpoint(policy=torch.nn.Linear(1, 1)).save(tmp_path / "saved")
    held = sorted(path.name for path in (tmp_path / "saved").rglob("*") if path.is_file())
    assert "sums.json" in held
    assert events == [f"all of {' '.join(held)}", "rename", str(tmp_path)]


def test_so_it_is_where_files_are_written_through_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(sums, "_syncfs", None)
    events = watched(monkeypatch)
    SummedCheckpoint(policy=torch.nn.Linear(1, 1)).save(tmp_path / "saved")
    named = events.index("rename")
    flushed = {Path(event).name for event in events[:named]}
    assert {path.name for path in (tmp_path / "saved").rglob("*")} <= flushed
    assert events[named + 1 :] == [str(tmp_path)]


def test_a_disk_that_does_not_take_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def failing(handle: int) -> int:
        ctypes.set_errno(errno.EIO)
        return -1

    monkeypatch.setattr(sums, "_syncfs", failing)
    with pytest.raises(OSError, match=r"Input/output error.*saved"):
        SummedCheckpoint(policy=torch.nn.Linear(1, 1)).save(tmp_path / "saved")
    assert not (tmp_path / "saved").exists()


def test_the_same_place_can_be_written_again(tmp_path: Path):
    for _ in range(2):
        module = torch.nn.Linear(1, 1)
        SummedCheckpoint(policy=module).save(tmp_path / "saved")
    assert [path.name for path in tmp_path.iterdir()] == ["saved"]
    again = torch.nn.Linear(1, 1)
    load_component(tmp_path / "saved", "policy", again)
    assert torch.equal(again.weight, module.weight)


def test_a_tensor_without_entries_has_no_file_and_misses_none(tmp_path: Path):
    saved = torch.nn.Linear(1, 1)
    saved.register_buffer("none", torch.zeros(0, 3))
    SummedCheckpoint(policy=saved).save(tmp_path / "saved")
    before = contents(tmp_path)
    loaded = torch.nn.Linear(1, 1)
    loaded.register_buffer("none", torch.zeros(0, 3))
    load_component(tmp_path / "saved", "policy", loaded)
    assert torch.equal(loaded.weight, saved.weight)
    assert contents(tmp_path) == before


def test_what_a_killed_process_left_goes_at_the_next_start(run_dir: Path):
    left = run_dir / "checkpoints" / "..checkpoint-000000000060.1234.stage-5678"
    shutil.copytree(checkpoint(run_dir, 40), left)
    assert latest_checkpoint(run_dir).name.endswith("40")
    assert left.exists(), "reading changes nothing"
    build_run(load_recipe(run_dir), run_dir, resume=True)
    assert not left.exists()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_damage_shows_in_the_checksums(kind: Damage, tmp_path: Path):
    for name in ("a/one", "two"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(Random(name).randbytes(100))
    write_sums(tmp_path)
    verify_sums(tmp_path)
    kind(tmp_path / "a" / "one", Random(0))
    if kind is link:  # its copy lies beside it
        with pytest.raises(DamagedError, match=r"one\.elsewhere: was not there"):
            verify_sums(tmp_path)
    else:
        with pytest.raises(DamagedError, match=r"a/one: (holds|is)"):
            verify_sums(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"files": {"two": [1]}}', '{"files": [1]}'])
def test_checksums_that_are_damaged_are_damage(text: str, tmp_path: Path):
    (tmp_path / SUMS).write_text(text)
    with pytest.raises(DamagedError, match=r"sums\.json: is no list of checksums"):
        verify_sums(tmp_path)


@pytest.mark.parametrize("every", [False, True], ids=["the_newest", "every"])
def test_a_damaged_cached_model_is_made_again(
    every: bool, tmp_path: Path, demos: Path, caplog: pytest.LogCaptureFixture
):
    config = tiny_config("ila_bc", tmp_path, demos, "bc.updates=200", "pretrain=true")
    config = config.changed(logging={"checkpoint_interval": 50})
    run = built(config)
    loaded = checkpoints_of_cache(tmp_path)
    assert len(loaded) == 2
    for path in loaded if every else loaded[-1:]:
        flip(tensor_of(path), Random(3))
    expected = run.actor.state_dict()
    shutil.rmtree(run.run_dir)
    with caplog.at_level(logging.WARNING):
        again = built(config)
    assert differences(again.actor.state_dict(), expected) == []
    told = "made again" if every else "is used in its place"
    assert sum(told in r.getMessage() for r in caplog.records) == 1
    caplog.clear()
    shutil.rmtree(again.run_dir)
    assert differences(built(config).actor.state_dict(), expected) == []
    assert not [r for r in caplog.records if "damaged" in r.getMessage()]


def checkpoints_of_cache(folder: Path) -> list[Path]:
    return sorted(folder.glob("cache/bc-*/checkpoints/checkpoint-*"))
