"""What is answered without torch, which takes seconds to import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.cli import COMMANDS

ROOT = Path(__file__).parents[3]
HEAVY = ("torch", "tensordict", "torchrl", "mujoco", "hydra")
RUNNER = (
    f"HEAVY = {HEAVY}"
    + """
import contextlib, io, json, sys
from pipeline import cli

for line in sys.stdin:
    sys.argv = ["bcsac", *json.loads(line)]
    said = io.StringIO()
    code = 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            cli.main()
        except SystemExit as end:
            code = end.code
    heavy = [name for name in HEAVY if name in sys.modules]
    print(json.dumps([code, said.getvalue(), heavy]), flush=True)
"""
)


class Runner:
    """One process that answers command lines: exit code or message, text, heavy modules loaded."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __call__(self, *arguments: str) -> tuple[int | str, str, list[str]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(arguments) + "\n")
        self._process.stdin.flush()
        code, said, heavy = json.loads(self._process.stdout.readline())
        return code, said, heavy


@pytest.fixture(scope="module")
def answered() -> Iterator[Runner]:
    process = subprocess.Popen(
        [sys.executable, "-c", RUNNER], cwd=ROOT, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    yield Runner(process)
    process.communicate()


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help(answered: Runner, command: str | None):
    code, said, heavy = answered(*([] if command is None else [command]), "--help")
    assert (code, heavy) == (0, [])
    assert f"Usage: bcsac {command or '[OPTIONS]'}" in said


def test_a_table(answered: Runner):
    rows = ROOT / "docs" / "results" / "rows"
    code, said, heavy = answered("table", str(rows / "best" / "seed0.json"))
    assert (code, heavy) == (0, [])
    assert "Table" in said or "best" in said


def test_a_plot(answered: Runner, tmp_path: Path):
    out = tmp_path / "plot.png"
    rows = ROOT / "docs" / "results" / "rows"
    code, _, heavy = answered("plot", str(rows / "best" / "seed0.json"), "--out", str(out))
    assert (code, heavy) == (0, [])
    assert out.stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eval", "--no-such"], 2),
        (["eval", "nowhere"], "error: nowhere is not a run directory: it holds no config.yaml."),
        (["video", "nowhere"], "error: nowhere is not a run directory: it holds no config.yaml."),
        (["video", "docs/results/policies/best", "--starts", "x"], "error: STARTS=x is no list"),
        (["record"], "error: make record takes RUN=dir"),
        (["plot", "nowhere"], "error: nowhere is no run"),
        (["table", "nowhere"], "error: nowhere does not exist; make it with: make eval"),
    ],
)
def test_refused_arguments(answered: Runner, arguments: list[str], message: int | str):
    code, _, heavy = answered(*arguments)
    assert heavy == []
    assert code == message if isinstance(message, int) else str(code).startswith(message)
