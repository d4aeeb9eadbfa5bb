"""What a run leaves and reaches: the same files for the same seed, the user's modes, no network."""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from envs.door.definition import TASK
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.run_files import EVALUATION
from pipeline.non_finite import BATCH, NonFiniteError
from pipeline.policy import WEIGHTS, load_policy, save_weights
from pipeline.results.evaluation_files import save_evaluation
from pipeline.run_dir import load_recipe
from tests.pipeline.resuming import curve_of
from tests.pipeline.toys import built, make_batch, tiny_config

TIMED = {
    "time_use.json", "wall_s.csv", "learning_curve.jsonl", "manifest.json", "sums.json",
    ".lock", "config.yaml", "versions.json",
}  # fmt: skip
"""Files that hold a time, a path or a git state, and the list of checksums over such files."""
OFTEN = ("logging.checkpoint_interval=10", "logging.interval=1")
TIMED_PARTS = ("-logger", "-trainer_module.time_use")


def contents(run_dir: Path) -> dict[str, bytes]:
    """Every file that a seed decides, by its path within the run."""
    return {
        path.relative_to(run_dir).as_posix(): path.read_bytes()
        for path in sorted(run_dir.rglob("*"))
        if path.is_file()
        and path.name not in TIMED
        and not any(folder.endswith(TIMED_PARTS) for folder in path.parts)
    }


def test_the_same_seed_gives_the_same_files(tmp_path: Path, demos: Path):
    """Checkpoints with buffers, optimizers and generators, logs and the learning curve."""
    found = []
    for name in ("one", "other"):
        torch.manual_seed(len(name))  # whatever was before must not matter
        run = built(tiny_config("sid_dbc", tmp_path / name, demos, *OFTEN))
        run.train()
        found.append((contents(run.run_dir), curve_of(run.run_dir)))
    (files, curve), (others, other_curve) = found
    assert files.keys() == others.keys()
    assert [name for name in files if files[name] != others[name]] == []
    assert curve == other_curve
    assert sum(name.endswith(".memmap") for name in files) > 50
    assert any(name.endswith(".csv") for name in files)


@pytest.fixture
def umask() -> Iterator[int]:
    """One that nobody else has in this session."""
    before = os.umask(0o027)
    yield 0o027
    os.umask(before)


def modes(folder: Path) -> dict[str, int]:
    return {
        path.relative_to(folder).as_posix(): stat.S_IMODE(path.stat().st_mode)
        for path in folder.rglob("*")
    }


def test_everything_that_is_written_has_the_users_modes(umask: int, demos: Path, tmp_path: Path):
    run = built(tiny_config("ila_bc", tmp_path, demos))
    run.train()
    save_evaluation(run.run_dir / EVALUATION, evaluate_run(run.run_dir, episodes=1))
    with pytest.raises(NonFiniteError):
        raise NonFiniteError("found", make_batch(2)).kept(run.run_dir)
    policy, _ = load_policy(load_recipe(run.run_dir), TASK, run.run_dir)
    save_weights(policy, tmp_path / WEIGHTS, frames=40)
    found = modes(tmp_path)
    assert {f"{run.run_dir.name}/{BATCH}", f"{run.run_dir.name}/{EVALUATION}", WEIGHTS} <= set(
        found
    )
    wrong = {
        name: oct(mode)
        for name, mode in found.items()
        if mode != (0o777 if (tmp_path / name).is_dir() else 0o666) & ~umask
        and not name.endswith(".lock")
    }
    assert wrong == {}


def test_a_run_and_its_evaluation_reach_no_network(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    """Nothing but a logger that is asked for (wandb, mlflow) has a reason to."""
    asked = []

    def refused(*given: object, **_options: object) -> None:
        asked.append(given)
        raise OSError("no network here")

    for name in ("socket", "create_connection", "getaddrinfo", "gethostbyname"):
        monkeypatch.setattr(socket, name, refused)
    loggers = "logging.loggers=[csv,tensorboard]"
    run = built(tiny_config("dbc_sac", tmp_path, demos, loggers))
    run.train()
    evaluate_run(run.run_dir, episodes=1)
    assert asked == []
