"""The command line: what users type, what they read, and exit codes."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

from envs.demonstrations import load_demonstrations, read_card
from pipeline import cli, train
from pipeline.build import build_run
from pipeline.tables import TABLE_1, TABLE_2
from tests.pipeline.toys import TINY, tiny_config

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
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Command]:
    """`make train`, in this process; Hydra's logging is taken down again."""
    monkeypatch.chdir(tmp_path)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level

    def run(*arguments: object) -> tuple[int, str, str]:
        typed = [str(argument) for argument in arguments]
        if not any(argument.startswith("resume=") for argument in typed):
            typed.append("preset=smoke")  # a resumed run brings its own
        monkeypatch.setattr(sys, "argv", ["pipeline.train", *typed])
        GlobalHydra.instance().clear()
        return outcome(train.main, capsys)

    yield run
    root.handlers[:], root.level = handlers, level
    GlobalHydra.instance().clear()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = build_run(tiny_config("bc_sac", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


def test_eval_writes_and_prints_the_columns(command: Command, trained: Path):
    code, printed, _ = command("eval", trained, "--episodes", 2)
    assert code == 0
    result = json.loads((trained / "evaluation.json").read_text())
    assert set(result) >= {*TABLE_1.values(), *TABLE_2.values(), "success_at_end"}
    assert result["episodes"] == 2
    made_from = result["made_from"]
    assert made_from["checkpoint"] == "checkpoint-000000000040"
    assert made_from["evaluation_seed"] == 20_000
    assert set(made_from) >= {"demos", "seed", "versions", "variant"}
    assert "return_mean" in printed
    assert str(trained / "evaluation.json") in printed


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
    assert str(out) in printed
    card = read_card(out)
    assert (card["kept"], card["attempts"], card["policy"]["variant"]) == (3, 4, "bc_sac")
    loaded = load_demonstrations(out, num_threads=1)
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
    assert "does not fit the schema" in error
    assert override.split("=")[0].split(".")[1] in error


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
    (checkpoint,) = (tmp_path / "run" / "checkpoints").iterdir()
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
        (("run_dir=taken",), "Run directory taken exists. Continue it with RESUME=taken"),
        (("run_dir=a-file/run",), "Run directory a-file/run cannot be written"),
        (("env.name=window",), "unknown environment 'window'"),
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
        (("resume=taken", "run_dir=other"), "leave out run_dir=other"),
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
    assert error.startswith("error: Checkpoint")
    assert "Use the configuration that the run was made with" in error
