"""The command line: what users type, what they read, and exit codes."""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

from envs import pictures
from envs.demonstrations import load_demonstrations, read_card
from envs.door.definition import TASK
from envs.door.paper import TABLE_1, TABLE_2
from pipeline import build, cli, train
from pipeline.commands import evaluate_run, record
from pipeline.film import performers
from pipeline.machine import extras
from pipeline.non_finite import NonFiniteError
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from tests.pipeline.toys import TINY, built, tiny_config

Command = Callable[..., tuple[int, str, str]]
"""Arguments in; exit code, standard output and the error message out."""


def outcome(main: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code: int | str | None = 0
    try:
        main()
    except SystemExit as stop:
        code = stop.code
    printed = capsys.readouterr()
    # sys.exit("text") prints it to standard error and exits with 1.
    if isinstance(code, str):
        return 1, printed.out, code
    return code or 0, printed.out, printed.err


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pipeline.cli", *map(str, arguments)])
        return outcome(cli.main, capsys)

    return run


@pytest.fixture
def training(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
) -> Iterator[Command]:
    """`make train`, in this process. What it logs counts as printed: with its own logging, Hydra
    would close the handlers of pytest."""
    monkeypatch.chdir(tmp_path)
    caplog.set_level(logging.INFO)

    def run(*arguments: object) -> tuple[int, str, str]:
        typed = [str(argument) for argument in arguments]
        if not any(argument.startswith("resume=") for argument in typed):
            typed.append("preset=smoke")  # a resumed run brings its own
        quiet = ["hydra/job_logging=none", "hydra/hydra_logging=none"]
        monkeypatch.setattr(sys, "argv", ["pipeline.train", *typed, *quiet])
        GlobalHydra.instance().clear()
        code, printed, error = outcome(train.run_command_line, capsys)
        return code, printed + caplog.text, error

    yield run
    GlobalHydra.instance().clear()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = built(tiny_config("bc_sac", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


def test_eval_writes_and_prints_the_columns(command: Command, trained: Path):
    code, printed, _ = command("eval", trained, "--episodes", 2)
    assert code == 0
    result = json.loads((trained / "evaluation.json").read_text())
    assert set(result) >= {*[c.key for c in (*TABLE_1, *TABLE_2)], "success_at_end"}
    assert result["episodes"] == 2
    made_from = result["made_from"]
    assert made_from["checkpoint"] == "checkpoint-000000000040"
    assert made_from["evaluation_seed"] == 20_000
    assert set(made_from) >= {"demos", "seed", "versions", "variant"}
    assert "return_mean" in printed
    assert str(trained / "evaluation.json") in printed


def test_eval_prints_no_row_of_what_is_not_known(command: Command, trained: Path):
    _, printed, _ = command("eval", trained, "--episodes", 2)
    result = json.loads((trained / "evaluation.json").read_text())
    unknown = [key for key, value in result.items() if value is None]
    assert unknown, "the file keeps them"
    assert not [key for key in unknown if key in printed]


def test_eval_takes_another_file_seed_and_action(command: Command, trained: Path, tmp_path: Path):
    def evaluated(name: str, *overrides: str) -> dict:
        out = tmp_path / "new" / name
        code, _, _ = command("eval", trained, *overrides, "--episodes", 2, "--out", out)
        assert code == 0
        return json.loads(out.read_text())

    first = evaluated("a.json")
    assert evaluated("b.json")["return_mean"] == first["return_mean"]
    other = evaluated("c.json", "evaluation.seed=5", "evaluation.exploration=sample")
    assert other["return_mean"] != first["return_mean"]
    assert other["made_from"]["evaluation_seed"] == 5
    assert other["made_from"]["exploration"] == "sample"
    noise = ("evaluation.exploration=sample", "evaluation.noise_scale=0.5")
    quieter = evaluated("d.json", "evaluation.seed=5", *noise)
    assert quieter["return_mean"] != other["return_mean"]
    assert quieter["made_from"]["noise_scale"] == 0.5


def test_eval_tells_strategies_unless_it_is_told_not_to(command: Command, trained: Path):
    """A policy of forty frames comes nowhere near a door, in ten steps."""
    command("eval", trained, "--episodes", 2)
    told = json.loads((trained / "evaluation.json").read_text())
    assert told["strategies"]["shares"]["untouched"] == 1.0
    header, *rows = (trained / "episodes.csv").read_text().splitlines()
    assert header.endswith("strategy,progress_at_last_contact,travel_untouched")
    assert [row.split(",")[-3:] for row in rows] == [["untouched", "", ""]] * 2
    command("eval", trained, "--episodes", 2, "--no-strategies")
    plain = json.loads((trained / "evaluation.json").read_text())
    assert "strategies" not in plain
    assert "strategy" not in (trained / "episodes.csv").read_text()
    assert {k: told[k] for k in plain if k not in ("made_from", "sha256")} == {
        k: plain[k] for k in plain if k not in ("made_from", "sha256")
    }


def test_robust_writes_a_table_and_a_figure(command: Command, trained: Path, tmp_path: Path):
    out = tmp_path / "new"
    asked = ("--episodes", 1, "--only", "action_noise", "--bar", 0.5, "--out", out)
    code, printed, _ = command("robust", trained, *asked)
    assert code == 0
    assert (out / "robustness.png").is_file()
    (ladder,) = json.loads((out / "robustness.json").read_text())["ladders"]
    assert ladder["first_below"] == "undisturbed"  # forty frames open nothing
    assert f"make robust RUN={trained} EPISODES=1 BAR=0.5 ONLY=action_noise`." in printed
    assert "noise on actions" in printed
    code, _, error = command("robust", trained, "--only", "wind")
    assert code == 1
    assert "wind is no disturbance of this task" in error


def test_table_sets_runs_beside_the_paper(command: Command, trained: Path, tmp_path: Path):
    command("eval", trained, "--episodes", 2)
    code, printed, _ = command(
        "table", trained, trained / "evaluation.json", "--out", tmp_path / "t.md"
    )
    assert code == 0
    assert printed.count("/ 955.8") == 2  # BC-SAC, lambda = 1
    assert (tmp_path / "t.md").read_text() == printed


def test_demos_check_has_a_line_per_demonstration(command: Command, demos: Path):
    code, printed, _ = command("demos-check", demos)
    assert code == 0
    assert "return" in printed
    assert len([line for line in printed.splitlines() if " 12 " in line]) == 2  # their length


def test_record_makes_a_set_that_loads(command: Command, trained: Path, tmp_path: Path):
    out = tmp_path / "set.h5"
    code, printed, _ = command("record", trained, "--out", out, "--episodes", 3, "--attempts", 4)
    assert code == 0
    card = read_card(out)
    assert printed.startswith(f"{card['admitted']} of {card['attempts']} episodes ")
    assert f"; the first 3 are in {out}. Next: make demos-check DEMOS={out} TASK=door" in printed
    assert len(printed.splitlines()) == 1
    assert (card["kept"], card["attempts"], card["policy"]["variant"]) == (3, 4, "bc_sac")
    loaded = load_demonstrations(out, TASK, num_threads=1)
    assert len(loaded.episodes) == 3
    # The simulator plays the recorded actions to the recorded observations.
    assert max(report.replay_error_max for report in loaded.reports) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("eval", "nowhere"), "nowhere is not a run directory: it holds no config.yaml"),
        (("record", "nowhere", "--out", "x.h5"), "nowhere is not a run directory"),
        (("table", "nowhere"), "nowhere does not exist; make it with: make eval RUN=nowhere"),
        (("demos-check", "nowhere.h5"), "nowhere.h5"),
        (("demos-check", "nowhere"), "nowhere"),
    ],
)
def test_what_does_not_exist_is_named(
    command: Command, arguments: tuple, message: str, tmp_path: Path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, _, error = command(*arguments)
    assert code == 1
    assert error.startswith("error: ")
    assert message in error


def test_record_without_enough_good_episodes_says_what_to_do(
    command: Command, trained: Path, tmp_path: Path
):
    code, _, error = command(
        "record", trained, "--out", tmp_path / "x.h5", "--episodes", 3, "--attempts", 2
    )
    assert code == 1
    assert "only 2 of 2 episodes passed growth.admission, 3 are wanted; train longer" in error
    assert not (tmp_path / "x.h5").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "is not an evaluation"), ("{}", "is not an evaluation"), ("[]", "is not an evaluation")],
)
def test_a_file_that_is_no_evaluation_is_named(
    command: Command, text: str, message: str, tmp_path: Path
):
    (tmp_path / "evaluation.json").write_text(text)
    code, _, error = command("table", tmp_path)
    assert code == 1
    assert message in error


@pytest.mark.parametrize("override", ["evaluation.sede=3", "evaluation.seed=x"])
def test_eval_refuses_overrides_that_the_schema_does_not_know(
    command: Command, trained: Path, override: str
):
    code, _, error = command("eval", trained, override, "--episodes", 1)
    assert code == 1
    assert override.split("=")[0] in error


def test_a_damaged_configuration_is_named(command: Command, tmp_path: Path):
    (tmp_path / "config.yaml").write_text("seed: [")
    code, _, error = command("eval", tmp_path)
    assert code == 1
    assert str(tmp_path / "config.yaml") in error


def test_train_then_resume_to_the_end(training: Command, demos: Path, tmp_path: Path):
    options = [f"demos.source='{demos}'", *TINY]
    code, printed, _ = training("variant=bc_sac", "run_dir=run", "seed=3", *options)
    assert code == 0
    assert "make eval RUN=run" in printed
    assert (tmp_path / "run" / "config.yaml").read_text().count("seed: 3") == 1
    code, _, error = training("resume=run", "collector.total_frames=60")
    assert (code, error) == (0, "")
    *_, checkpoint = sorted((tmp_path / "run" / "checkpoints").iterdir())
    assert checkpoint.name == "checkpoint-000000000060"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("variant=imaginary",), "imaginary"),
        (("loss.bc_wieght.init=1",), "bc_wieght"),
        (("seed=three",), "three"),
    ],
)
def test_hydra_names_what_it_does_not_know(training: Command, arguments: tuple, message: str):
    code, _, error = training(*arguments)
    assert code == 1
    assert message in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("demos.source=missing.h5",), "missing.h5"),
        (("demos.source=bad.pickle",), "bad.pickle"),
        (("run_dir=taken",), "taken exists and is no run directory: remove it, or choose another"),
        (("run_dir=a-file/run",), "Run directory a-file/run cannot be written"),
        (("task.name=window",), "unknown task 'window'"),
        (("logging.loggers=[neptune]",), "unknown ['neptune']; choose from"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_1(
    training: Command, arguments: tuple, message: str, demos: Path, tmp_path: Path
):
    (tmp_path / "taken").mkdir()
    (tmp_path / "a-file").write_text("")
    (tmp_path / "bad.pickle").write_bytes(b"not a pickle")
    code, _, error = training("variant=bc_sac", f"demos.source='{demos}'", *TINY, *arguments)
    assert code == 1
    assert error.startswith("error: ")
    assert message in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("resume=taken",), "taken is not a run directory: it holds no config.yaml"),
        (("resume=taken", "variant=sac"), "leave out variant=sac"),
        (("resume=taken", "seed=3"), "leave out seed=3"),
        (("resume=taken", "run_dir=other"), "leave out run_dir='other'"),
    ],
)
def test_resume_says_what_is_wrong_with_it(
    training: Command, arguments: tuple, message: str, tmp_path: Path
):
    (tmp_path / "taken").mkdir()
    code, _, error = training(*arguments)
    assert code == 1
    assert message in error


def test_checkpoint_of_another_architecture_is_one_line(
    training: Command, trained: Path, demos: Path
):
    code, _, error = training(f"resume='{trained}'", "critic.hidden=[16]")
    assert code == 1
    assert error.startswith(f"error: {trained} was made with other values")
    assert "critic.hidden  [32, 32]      [16]" in error


ODD = 'run\'s a=1,b $HOME "q" ü'


def test_a_run_of_an_odd_name_is_trained_resumed_and_evaluated(
    training: Command, command: Command, demos: Path, tmp_path: Path
):
    run_dir, source = tmp_path / ODD, tmp_path / f"{ODD}.h5"
    source.write_bytes(demos.read_bytes())
    given = [f"run_dir={run_dir}", f"demos.source={source}", "variant=bc", "logging.loggers=[csv]"]
    assert training(*given, *TINY, f"cache_dir={tmp_path / ODD} cache")[::2] == (0, "")
    moved = f"{tmp_path / ODD} other cache"
    code, _, error = training(f"resume={run_dir}", f"cache_dir={moved}", "bc.updates=200")
    assert (code, error) == (0, "")
    recipe = load_recipe(run_dir)
    assert (recipe.demos.source, recipe.cache_dir) == (str(source), moved)
    code, _, error = command(
        "eval", run_dir, "--episodes", 1, "--out", tmp_path / ODD / "o'ut.json"
    )
    assert (code, error) == (0, "")


def test_a_missing_extra_is_named_before_any_work(
    training: Command, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    monkeypatch.delitem(sys.modules, "wandb", raising=False)
    monkeypatch.setattr(build, "make_demonstrations", None)  # the first thing that takes time
    given = [f"run_dir={tmp_path / 'run'}", f"demos.source={demos}", "variant=bc"]
    code, _, error = training(*given, "logging.loggers=[csv,wandb]")
    assert code == 1
    assert "logging.loggers=[csv,wandb] needs wandb" in error
    assert "pip install 'bc-sac[wandb]'" in error
    assert "\n" not in error.rstrip()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "module", "extra"),
    [
        (["video", "RUN"], "imageio", "video"),
        (["strip", "RUN"], "imageio", "video"),
        (["plot", "RUN"], "matplotlib", "results"),
        (["results", "RUN"], "matplotlib", "results"),
    ],
)
def test_an_extra_of_a_command_is_named(
    arguments: list, module: str, extra: str, command: Command, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):  # fmt: skip
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    for name in extras.EXTRAS:
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "config.yaml").touch()
    code, _, error = command(*[a if a != "RUN" else tmp_path for a in arguments])
    assert code == 1
    assert f"make {arguments[0]} needs {module}, which comes with the extra '{extra}'" in error


def test_recording_to_minari_without_it_says_so_before_episodes_are_played(
    command: Command, trained: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "minari", None)
    monkeypatch.setattr(record, "rollout_waves", None)
    code, _, error = command("record", trained, "--out", "minari:door/mine-v0")
    assert code == 1
    assert "needs the package minari" in error
    assert "pip install 'bc-sac[minari]'" in error


def test_numbers_that_are_not_finite_have_an_exit_code_of_their_own(
    training: Command, command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def broken(*_arguments: object, **_options: object) -> None:
        raise NonFiniteError("next.reward is nan at frame 3")

    monkeypatch.setattr(train, "build_run", broken)
    code, _, error = training("variant=sac")
    assert (code, error) == (3, "error: next.reward is nan at frame 3\n")
    monkeypatch.setattr(evaluate_run, "run_evaluation", broken)
    (tmp_path / "config.yaml").touch()
    code, _, error = command("eval", tmp_path)
    assert (code, error) == (3, "error: next.reward is nan at frame 3\n")


def test_a_full_disk_is_one_line(training: Command, monkeypatch: pytest.MonkeyPatch):
    def full(*_arguments: object, **_options: object) -> None:
        raise OSError(28, "No space left on device", "run/logs/x.csv")

    monkeypatch.setattr(train, "build_run", full)
    code, _, error = training("variant=sac")
    assert code == 1
    assert error.startswith("error: run/logs/x.csv: No space left on device: no space left. The")


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (("eval", "--episodes", "1", "--out"), "e.json"),
        (("plot", "--out"), "p.png"),
    ],
    ids=lambda words: words[0],
)
def test_what_finds_no_room_names_its_file_and_leaves_the_one_before(
    command: Command,
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    written: str,
):
    out = tmp_path / written
    out.write_text("good")
    fsync = os.fsync

    def full(handle: int) -> None:
        if str(tmp_path) in os.readlink(f"/proc/self/fd/{handle}"):
            raise OSError(errno.ENOSPC, "No space left on device")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    code, _, error = command(words[0], trained, *words[1:], out)
    assert code == 1
    assert error.startswith(f"error: {out.parent}/")
    assert error.endswith(": No space left on device: free some space there, and run this again.")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(written, "good")]


def test_a_sweep_runs_all_of_its_jobs_and_reports_those_that_failed(
    training: Command, monkeypatch: pytest.MonkeyPatch
):
    ran = []

    def some(recipe: Recipe, run_dir: Path, **_options: object) -> None:
        ran.append(recipe.seed)
        raise ValueError(f"of seed {recipe.seed}")

    monkeypatch.setattr(train, "build_run", some)
    code, _, error = training("--multirun", "seed=0,1,2", "variant=sac")
    assert code == 1
    assert ran == [0, 1, 2]
    assert "3 of 3 jobs failed" in error
    for seed in ran:
        assert f"seed={seed}" in error
        assert f"of seed {seed}" in error


def test_each_run_of_a_sweep_has_a_directory_of_its_own(
    training: Command, monkeypatch: pytest.MonkeyPatch
):
    kept = []

    def some(_recipe: Recipe, run_dir: Path, **_options: object) -> None:
        kept.append(str(run_dir))
        raise ValueError("enough")

    monkeypatch.setattr(train, "build_run", some)
    training("--multirun", "loss.gamma=0.9,0.99", "variant=sac", "preset=smoke")
    training("--multirun", "actor.hidden=[8],[8,8]", "variant=sac", "preset=smoke")
    folder = "runs/sac-smoke-seed0"
    assert kept[:2] == [f"{folder}-loss.gamma-0.9", f"{folder}-loss.gamma-0.99"]
    assert kept[2:] == [f"{folder}-job0", f"{folder}-job1"]


def test_where_nothing_can_be_rendered_is_one_line_before_any_work(
    command: Command, trained: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(pictures, "find_library", lambda _name: None)
    monkeypatch.setattr(performers, "load_policy", None)  # calling it would say so
    for name in (*pictures.SCREENS, pictures.CHOSEN):
        monkeypatch.delenv(name, raising=False)
    code, _, error = command("video", trained)
    assert code == 1
    assert "no EGL and no OSMesa. On a machine without a display: apt-get install" in error
    assert "\n" not in error.rstrip()
    assert not (trained / "video.mp4").exists()


def test_the_worst_need_an_evaluation(command: Command, trained: Path, tmp_path: Path):
    elsewhere = tmp_path / "run"
    shutil.copytree(trained, elsewhere, ignore=shutil.ignore_patterns("evaluation*", "*.csv"))
    code, _, error = command("video", elsewhere, "--worst", 2)
    assert code == 1
    assert f"make it with: make eval RUN={elsewhere}" in error
