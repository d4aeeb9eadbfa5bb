"""A run that is told to stop can go on as if it had not been; a full disk costs no checkpoint."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from omegaconf import OmegaConf

from pipeline import train
from pipeline.build import build_run
from pipeline.machine.disk import training_stopped_by
from pipeline.machine.interruption import TOGETHER_S, Interrupted, StopRequest, interruption
from pipeline.recipe import Recipe
from pipeline.run_dir import create_run_dir, load_recipe
from pipeline.trainer import Run
from tests.pipeline.resuming import curve_of, differences
from tests.pipeline.test_resuming import FILE, recipe_of, resumed
from tests.test_toy import whole

UPDATES = ("optim.updates_per_frame=0.25", "logging.checkpoint_interval=1000")
"""Five updates in each portion of 20 frames, and no checkpoint but the last."""


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, list[dict]]:
    run_dir = tmp_path_factory.mktemp("whole") / "run"
    run = build_run(recipe_of(*UPDATES), run_dir)
    run.train()
    return whole(run), curve_of(run_dir)


def stop_after(run: Run, updates: int) -> None:
    """As by a signal in the middle of that update."""
    count = []

    def made() -> None:
        count.append(1)
        if len(count) == updates:
            run.stop.signum = signal.SIGTERM

    run.trainer.register_op("post_optim", made)


def stop_in_evaluation(run: Run, steps: int) -> list[str]:
    """As by a signal there; returns what is done after it."""
    left, after = iter(range(steps, -1, -1)), []
    leave = run.evaluation.evaluator.between_steps

    def between() -> None:
        if next(left, 1) == 0:
            run.stop.make(signal.SIGINT)
            after.append("the rest of a step of all copies")
        leave()

    object.__setattr__(run.evaluation.evaluator, "between_steps", between)
    return after


@pytest.mark.parametrize("updates", [1, 8, 10, 28, 30])
def test_a_run_that_is_stopped_after_any_update_goes_on_as_if_it_had_not_been(
    updates: int, uninterrupted: tuple[dict, list[dict]], tmp_path: Path
):
    run = build_run(recipe_of(*UPDATES), tmp_path / "run")
    stop_after(run, updates)
    with pytest.raises(Interrupted) as stop:
        run.train()
    assert stop.value.exit_code == 143
    assert run.trainer.optimization_stepper.critic_updates == updates
    torch.manual_seed(4321)
    again = resumed(tmp_path / "run")
    again.train()
    expected, curve = uninterrupted
    assert differences(whole(again), expected) == []
    assert curve_of(tmp_path / "run") == curve


def test_what_is_stopped_twice_in_one_portion_goes_on_too(
    uninterrupted: tuple[dict, list[dict]], tmp_path: Path
):
    run = build_run(recipe_of(*UPDATES), tmp_path / "run")
    stop_after(run, 6)
    with pytest.raises(Interrupted):
        run.train()
    again = resumed(tmp_path / "run")
    stop_after(again, 2)
    with pytest.raises(Interrupted):
        again.train()
    last = resumed(tmp_path / "run")
    assert last.updates.owed == 2, "what was made between the two stops is kept"
    last.train()
    expected, curve = uninterrupted
    assert differences(whole(last), expected) == []
    assert curve_of(tmp_path / "run") == curve


@pytest.mark.parametrize("steps", [3, 25])
def test_an_evaluation_that_is_cut_short_is_made_again(
    steps: int, uninterrupted: tuple[dict, list[dict]], tmp_path: Path
):
    """Episodes have 20 steps: the first evaluation, or the second."""
    run = build_run(recipe_of(*UPDATES), tmp_path / "run")
    after = stop_in_evaluation(run, steps)
    with pytest.raises(Interrupted) as stop:
        run.train()
    assert after == []
    assert stop.value.exit_code == 130
    again = resumed(tmp_path / "run")
    again.train()
    expected, curve = uninterrupted
    assert differences(whole(again), expected) == []
    assert curve_of(tmp_path / "run") == curve


def test_before_there_is_a_run_a_signal_ends_it_at_once():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupted, match="SIGTERM"), interruption():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_second_signal_is_the_system_s_own(monkeypatch: pytest.MonkeyPatch):
    request, sent = StopRequest(), []
    monkeypatch.setattr("os.kill", lambda _pid, signum: sent.append(signum))
    with interruption() as handler:
        handler.asks(request)
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # the same: make and a cluster signal a job twice
        assert (request.signum, sent) == (signal.SIGINT, [])
        time.sleep(TOGETHER_S)
        signal.raise_signal(signal.SIGINT)
        assert sent == [signal.SIGINT]
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL


@pytest.mark.parametrize(
    ("work", "codes"),
    [
        ("time.sleep(60)", {-signal.SIGTERM}),
        # In code that hears of no signal; Python's handler is called once it has returned.
        ("hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)", {128 + signal.SIGTERM}),
    ],
)
def test_the_second_signal_ends_the_process_whatever_it_does(work: str, codes: set[int]):
    program = (
        "import hashlib, time\n"
        "from pipeline.machine.interruption import StopRequest, interruption\n"
        "with interruption() as handler:\n"
        "    handler.asks(StopRequest())\n"
        f"    print('begun', flush=True); {work}"
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    for _ in range(2):
        time.sleep(1.0)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=20) in codes
    process.stdout.close()


@pytest.mark.parametrize("forked", [True, False], ids=["beside a child", "twice"])
def test_one_request_that_arrives_several_times_is_one(forked: bool):
    """`timeout` sends it to make's whole job; a forked child hears a terminal's, and its own."""
    child = "(os.fork() or time.sleep(9))" if forked else "0"
    program = (
        "import os, time\n"
        "from pipeline.machine.interruption import GRACE_S, StopRequest, interruption\n"
        "with interruption() as handler:\n"
        "    handler.asks(StopRequest())\n"
        f"    print({child}, flush=True)\n"
        "    end = time.monotonic() + 3 + 3 * GRACE_S\n"
        "    while time.monotonic() < end: time.sleep(0.01)\n"
        "print('saved', flush=True)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        begun = int(process.stdout.readline())
        try:
            if begun:  # a task ends its child, long before anybody stops the run
                time.sleep(2 * TOGETHER_S)
                os.kill(begun, signal.SIGTERM)
                time.sleep(2 * TOGETHER_S)
            for _ in range(2 - forked):
                os.killpg(process.pid, signal.SIGINT)
                time.sleep(TOGETHER_S / 5)  # or the system makes one of them
            assert process.stdout.readline() == "saved\n"
            assert process.wait(timeout=20) == 0
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def interrupted_inside(request: StopRequest, after: list[str]) -> None:
    with request.at_once():
        signal.raise_signal(signal.SIGINT)
        after.append("it went on")


@pytest.mark.parametrize("asked_before", [False, True])
def test_what_is_done_again_anyway_ends_at_once(asked_before: bool):
    request, after = StopRequest(), []
    with interruption() as handler:
        handler.asks(request)
        if asked_before:
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(Interrupted, match="SIGINT"):
            interrupted_inside(request, after)
    assert request.made
    assert after == []


def test_outside_of_it_a_signal_is_a_request():
    request = StopRequest()
    with interruption() as handler:
        handler.asks(request)
        with request.at_once():
            pass
        signal.raise_signal(signal.SIGINT)
    assert request.made


def test_the_end_of_a_stopped_command_is_not_spent_on_garbage(monkeypatch: pytest.MonkeyPatch):
    """With all that a training imports, that took seconds of processor time."""

    def stopped(*_given: object) -> None:
        raise Interrupted(signal.SIGTERM)

    at_exit: list[object] = []
    monkeypatch.setattr(train, "_train", stopped)
    monkeypatch.setattr("atexit.register", at_exit.append)
    with pytest.raises(SystemExit) as end:
        train._failure(OmegaConf.create())
    assert end.value.code == 143
    assert gc.freeze in at_exit


def command(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.train", *arguments],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


@pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_to_the_command_ends_it_in_one_line(
    signum: signal.Signals, code: int, tmp_path: Path
):
    run_dir, curve = tmp_path / "run", tmp_path / "run" / "learning_curve.jsonl"
    process = command(
        "variant=sac", "preset=smoke", f"task.name='{FILE}'", f"run_dir='{run_dir}'",
        "collector.total_frames=1000000", "torch_threads=1", "compile_updates=false",
    )  # fmt: skip
    while not curve.exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signum)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == code
    (line,) = [one for one in printed.splitlines() if "stopped" in one]
    assert line.endswith(f"frames; go on with: make train RESUME={run_dir} TASK={FILE}")
    assert "Traceback" not in printed
    assert list((run_dir / "checkpoints").glob("checkpoint-*"))


def test_a_checkpoint_for_which_there_is_no_room_leaves_the_last_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run = build_run(recipe_of("logging.checkpoint_interval=10"), tmp_path / "run")
    frames = run.trainer

    def usage(_path: Path) -> SimpleNamespace:
        return SimpleNamespace(free=10**12 if frames.collected_frames < 60 else 1000)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    with pytest.raises(OSError, match=r"a checkpoint takes .* MiB, of which 0.0 are free") as error:
        run.train()
    assert error.value.errno == errno.ENOSPC
    assert "no space left. The last checkpoint is as it was: free some" in training_stopped_by(
        error.value
    )
    checkpoints = sorted((tmp_path / "run" / "checkpoints").glob("checkpoint-*"))
    assert checkpoints[-1].name == "checkpoint-000000000040"
    monkeypatch.undo()
    resumed(tmp_path / "run").train()


@pytest.mark.parametrize(
    ("offline", "counted"), [(False, "40 frames"), (True, "40 updates of cloning")]
)
def test_what_a_stopped_run_has_counted_is_named(
    offline: bool, counted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    train_and_stop(Recipe().changed(offline=offline), tmp_path, monkeypatch)
    assert capsys.readouterr().err.startswith(f"stopped at {counted}; go on with: make train ")


def test_a_stopped_run_is_told_its_own_files_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    """Words that let it go on."""
    loss = {"own_terms": ["a.py:A"], "bc_weight": {"kind": "b.py:B", "period": 3}}
    recipe = Recipe().changed(loss=loss)
    train_and_stop(recipe, tmp_path, monkeypatch)
    named = ["loss.own_terms=[a.py:A]", "loss.bc_weight.kind=b.py:B"]
    assert capsys.readouterr().err.endswith(f" ARGS='{' '.join(named)}'\n")
    monkeypatch.delenv("TRUST", raising=False)
    create_run_dir(tmp_path / "run", recipe)
    assert load_recipe(tmp_path / "run", named, training=True) == recipe


def train_and_stop(recipe: Recipe, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command, stopped by a signal after 40 frames or updates."""

    def stopped() -> None:
        raise Interrupted(signal.SIGTERM)

    run = SimpleNamespace(
        run_dir=folder, stop=None, train=stopped, trainer=SimpleNamespace(collected_frames=40)
    )
    monkeypatch.setattr(train, "resolve", lambda _config: (recipe, folder, False))
    monkeypatch.setattr(train, "build_run", lambda *_arguments, **_options: run)
    with pytest.raises(Interrupted):
        train._train(OmegaConf.create(), SimpleNamespace(asks=lambda _stop: None))


def test_a_curve_that_cannot_be_written_ends_the_run(tmp_path: Path):
    run = build_run(recipe_of(), tmp_path / "run")
    (tmp_path / "run" / "learning_curve.jsonl").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left on device"):
        run.train()
