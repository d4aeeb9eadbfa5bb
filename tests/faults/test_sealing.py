"""A checkpoint is sealed beside the training: never half, never two at once, never forgotten."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from pipeline.build import build_run
from pipeline.files import rotation
from pipeline.files.background import BackgroundWork
from pipeline.files.run_files import RunDirectoryError
from pipeline.files.run_format import verify_checkpoint
from pipeline.files.run_lock import LOCK
from pipeline.machine.interruption import Interrupted
from pipeline.non_finite import NonFiniteError
from pipeline.train import run_command_line
from pipeline.trainer import Run
from tests.faults.killing import compared, in_a_child
from tests.pipeline.machine.test_interruption import stop_after
from tests.pipeline.resuming import curve_of, differences
from tests.pipeline.test_resuming import FILE, recipe_of, resumed
from tests.test_toy import whole

EACH = ("optim.updates_per_frame=0.25", "logging.checkpoint_interval=39", "torch_threads=1")
"""Checkpoints at 40, 80 and 120 frames; portions have 20. With more threads, a child that is forked
waits for ever for those of its parent."""
PATIENCE_S = 60.0

Seal = Callable[[Path, Path], None]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, list[dict]]:
    run_dir = tmp_path_factory.mktemp("whole") / "run"
    run = build_run(recipe_of(*EACH), run_dir)
    run.train()
    return whole(run), curve_of(run_dir)


def checkpoint(run_dir: Path, frames: int) -> Path:
    return run_dir / "checkpoints" / f"checkpoint-{frames:012d}"


def named(run_dir: Path) -> list[int]:
    found = (run_dir / "checkpoints").glob("checkpoint-*")
    return sorted(int(path.name.rpartition("-")[2]) for path in found)


def hidden(run_dir: Path) -> list[Path]:
    return list((run_dir / "checkpoints").glob(".*"))


def at(frames: int, what: Callable[[], None], then: Seal | None = rotation.seal) -> Seal:
    """Work that does ``what`` before the checkpoint of ``frames``, and ``then`` as usual."""

    def seal(stage: Path, destination: Path) -> None:
        if destination.name.endswith(f"-{frames:012d}"):
            what()
        then(stage, destination)

    return seal


def full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "sums.json")


def full_at(frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a disk that fills up while the checkpoint of ``frames`` is sealed."""
    write = rotation.write_sums

    def write_sums(stage: Path) -> None:
        if f"-{frames:012d}." in stage.name:
            full()
        write(stage)

    monkeypatch.setattr(rotation, "write_sums", write_sums)


def test_what_is_sealed_forty_frames_late_is_of_the_moment_it_was_written_in(
    uninterrupted: tuple[dict, list[dict]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Training goes on, and changes networks, buffers and generators meanwhile."""
    later, seen = threading.Event(), []
    monkeypatch.setattr(rotation, "seal", at(40, lambda: later.wait(PATIENCE_S)))
    run = build_run(recipe_of(*EACH), tmp_path / "run")

    def dies() -> None:
        if run.trainer.collected_frames == 80:
            seen.extend([named(tmp_path / "run"), len(hidden(tmp_path / "run"))])
            later.set()
            raise KeyboardInterrupt

    run.trainer.register_op("post_steps", dies)
    with pytest.raises(KeyboardInterrupt):
        run.train()
    assert seen == [[], 1]
    assert named(tmp_path / "run") == [40]
    torch.manual_seed(4321)
    again = resumed(tmp_path / "run")
    again.train()
    expected, curve = uninterrupted
    assert differences(whole(again), expected) == []
    assert curve_of(tmp_path / "run") == curve


def killed_before(_stage: Path, _destination: Path) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def killed_between(stage: Path, destination: Path) -> None:
    rotation.write_sums(stage)
    killed_before(stage, destination)


def killed_before_the_old_one_goes(stage: Path, destination: Path) -> None:
    rotation.write_sums(stage)
    rotation.replace_folder(stage, destination)
    killed_before(stage, destination)


@pytest.mark.parametrize(
    ("killed", "left", "frames"),
    [
        (killed_before, [40, 80], 80),
        (killed_between, [40, 80], 80),
        (killed_before_the_old_one_goes, [40, 80, 120], 120),
    ],
)
def test_a_run_that_is_killed_while_it_seals_goes_on_from_the_old_one_or_the_new_one(
    killed: Seal, left: list[int], frames: int, uninterrupted: tuple[dict, list[dict]],
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
):  # fmt: skip
    with monkeypatch.context() as patch:
        usual = rotation.seal

        def seal(stage: Path, destination: Path) -> None:
            (killed if destination.name.endswith("120") else usual)(stage, destination)

        patch.setattr(rotation, "seal", seal)
        recipe = recipe_of(*EACH)
        ended = in_a_child(lambda: build_run(recipe, tmp_path / "run").train())
    assert ended.code is None, "killed"
    assert named(tmp_path / "run") == left
    torch.manual_seed(4321)
    again = resumed(tmp_path / "run")
    assert again.trainer.collected_frames == frames
    assert hidden(tmp_path / "run") == []
    again.train()
    expected, curve = uninterrupted
    assert differences(whole(again), expected) == []
    assert curve_of(tmp_path / "run") == curve
    assert named(tmp_path / "run")[-2:] == [80, 120]


def test_rows_that_a_checkpoint_covers_are_there_when_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Loggers write late, and a run that goes on from it does not write them again."""
    recipe = recipe_of(*EACH, "logging.loggers=[csv,tensorboard]")
    build_run(recipe, tmp_path / "whole").train()
    with monkeypatch.context() as patch:
        usual = rotation.seal

        def seal(stage: Path, destination: Path) -> None:
            usual(stage, destination)
            if destination.name.endswith("80"):
                os.kill(os.getpid(), signal.SIGKILL)

        patch.setattr(rotation, "seal", seal)
        assert in_a_child(lambda: build_run(recipe, tmp_path / "run").train()).code is None
    assert max(named(tmp_path / "run")) == 80
    resumed(tmp_path / "run").train()
    assert compared(tmp_path / "run", tmp_path / "whole", f"task.name='{FILE}'") == []


@pytest.mark.parametrize("frames", [80, 120], ids=["on_the_way", "the_last"])
def test_a_seal_that_fails_ends_the_run_with_its_error(
    frames: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run = build_run(recipe_of(*EACH), tmp_path / "run")
    full_at(frames, monkeypatch)
    with pytest.raises(OSError, match="No space left") as failed:
        run.train()
    assert failed.value.errno == errno.ENOSPC
    assert run.trainer.collected_frames >= frames
    assert max(named(tmp_path / "run")) == frames - 40
    assert hidden(tmp_path / "run") == []
    assert not held(run)


def test_it_ends_at_the_next_portion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    run = build_run(recipe_of(*EACH), tmp_path / "run")
    full_at(40, monkeypatch)
    begin = run.sealing.begin

    def at_once(work: Callable[[], object]) -> None:
        begin(work)
        run.sealing._thread.join()

    monkeypatch.setattr(run.sealing, "begin", at_once)
    with pytest.raises(OSError, match="No space left"):
        run.train()
    assert run.trainer.collected_frames == 60


def test_the_command_says_so_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
):
    full_at(120, monkeypatch)
    monkeypatch.setattr(sys, "argv", [
        "train", "variant=sac", "preset=smoke", f"task.name='{FILE}'", "logging.progress=false",
        f"run_dir='{tmp_path / 'run'}'", f"cache_dir='{tmp_path / 'cache'}'", "torch_threads=1",
        "collector.total_frames=120", "collector.frames_per_batch=20",
    ])  # fmt: skip
    assert in_a_child(run_command_line).code == 1
    printed = capfd.readouterr().err
    (line,) = [one for one in printed.splitlines() if one.startswith("error: ")]
    assert "no space left. The last checkpoint is as it was: free some space" in line
    assert "Traceback" not in printed


def held(run: Run) -> bool:
    """Whether nobody else can have its lock, as another process sees it."""
    with (run.run_dir / LOCK).open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def test_a_new_run_is_locked_and_a_resume_that_is_refused_locks_nothing(tmp_path: Path):
    run = build_run(recipe_of(*EACH), tmp_path / "run")
    assert held(run)
    run.train()
    with pytest.raises(RunDirectoryError, match="cannot change"):
        resumed(tmp_path / "run", "loss.gamma=0.5")
    assert not held(run)


def late(run: Run, seen: list[bool]) -> Callable[[], None]:
    """BackgroundWork that takes longer than all that is left of the run."""

    def wait() -> None:
        time.sleep(0.3)
        seen.append(held(run))

    return wait


def test_a_request_to_stop_waits_for_the_seal_and_so_does_the_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run, locked = build_run(recipe_of(*EACH), tmp_path / "run"), []
    monkeypatch.setattr(rotation, "seal", at(60, late(run, locked)))
    stop_after(run, 12)
    with pytest.raises(Interrupted):
        run.train()
    assert locked == [True]
    assert named(tmp_path / "run") == [40, 60]
    verify_checkpoint(checkpoint(tmp_path / "run", 60))
    assert not held(run)


def test_a_run_that_is_told_to_stop_does_not_promise_what_it_could_not_seal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run = build_run(recipe_of(*EACH), tmp_path / "run")
    full_at(60, monkeypatch)
    stop_after(run, 12)
    with pytest.raises(OSError, match="No space left"):
        run.train()
    assert named(tmp_path / "run") == [40]


def test_a_run_that_is_complete_owes_its_seal_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Stopped in its last portion, it goes on with the updates that it owes, and saves again."""
    run = build_run(recipe_of(*EACH), tmp_path / "run")
    stop_after(run, 28)
    with pytest.raises(Interrupted):
        run.train()
    full_at(120, monkeypatch)
    with pytest.raises(OSError, match="No space left"):
        resumed(tmp_path / "run").train()
    verify_checkpoint(checkpoint(tmp_path / "run", 120))


def test_an_error_of_the_run_waits_for_the_seal_and_is_the_one_that_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    run, locked = build_run(recipe_of(*EACH), tmp_path / "run"), []

    def slow_and_full() -> None:
        late(run, locked)()
        full()

    monkeypatch.setattr(rotation, "seal", at(40, slow_and_full))

    def diverges() -> None:
        if run.trainer.collected_frames == 60:
            raise NonFiniteError("critic", None)

    run.trainer.register_op("pre_optim_steps", diverges)
    with caplog.at_level(logging.ERROR), pytest.raises(NonFiniteError, match="critic"):
        run.train()
    assert locked == [True]
    assert any("is lost: [Errno 28] No space left" in told for told in caplog.messages)


def test_two_are_never_under_way_and_the_newest_are_kept_at_every_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run_dir, events, usual = tmp_path / "run", [], rotation.seal
    room = shutil.disk_usage

    def seal(stage: Path, destination: Path) -> None:
        events.append(("seal", named(run_dir)))
        if destination in (checkpoint(run_dir, 20), checkpoint(run_dir, 60)):
            time.sleep(1.0)  # a portion takes less
        usual(stage, destination)
        events.append(("sealed", named(run_dir)))

    def usage(path: Path) -> object:
        events.append(("room", named(run_dir)))
        return room(path)

    monkeypatch.setattr(rotation, "seal", seal)
    monkeypatch.setattr(shutil, "disk_usage", usage)
    run = build_run(recipe_of(*EACH, "logging.checkpoint_interval=10"), run_dir)
    run.train()
    steps = list(range(20, 140, 20))
    kept = [[step for step in steps if step <= newest][-2:] for newest in [0, *steps]]
    with_new = [[*before, step] for before, step in zip(kept, steps, strict=False)]
    assert events == [
        event
        for before, after in zip(kept, with_new, strict=False)
        for event in (("room", before), ("seal", before), ("sealed", after))
    ]
    assert named(run_dir) == steps[-2:]


def test_what_lies_behind_a_link_is_not_cleared_away(tmp_path: Path):
    (elsewhere := tmp_path / "elsewhere" / ".checkpoint-000000000020.1234").mkdir(parents=True)
    (tmp_path / "checkpoints").symlink_to(elsewhere.parent)
    rotation.make_rotation(tmp_path, keep=2)
    assert elsewhere.is_dir()


def test_nothing_is_written_while_the_one_before_is_sealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Whoever saves: two copies of all buffers would lie on the disk beside those that are kept."""
    monkeypatch.setattr(rotation, "seal", at(1, lambda: time.sleep(0.2)))
    saves, found = rotation.SealedRotation(tmp_path / "checkpoints", keep_last=2), []
    state = torch.nn.Linear(1, 1)
    written = state.state_dict
    monkeypatch.setattr(state, "state_dict", lambda: (found.append(named(tmp_path)), written())[1])
    for step in (1, 2):
        saves.save(rotation.SummedCheckpoint(state=state), step=step)
    saves.sealing.settle()
    assert found == [[], [1]]


def test_what_failed_is_raised_once_and_by_whoever_comes_next():
    sealing = BackgroundWork()
    sealing.settle()
    sealing.check()
    sealing.begin(full)
    done = []
    with pytest.raises(OSError, match="No space left"):
        sealing.begin(lambda: done.append("never"))
    sealing.settle()
    assert done == []
    sealing.begin(lambda: done.append("now"))
    sealing.settle()
    assert done == ["now"]


def test_looking_does_not_wait():
    sealing, go = BackgroundWork(), threading.Event()

    def fails_later() -> None:
        go.wait(PATIENCE_S)
        full()

    sealing.begin(fails_later)
    sealing.check()
    go.set()
    sealing._thread.join()
    with pytest.raises(OSError, match="No space left"):
        sealing.check()
    assert [one.name for one in threading.enumerate() if one.name == "seal"] == []
