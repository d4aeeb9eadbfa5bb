"""The clone that reinforcement learning begins with is judged first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from configs import compose
from envs.intervals import wilson
from pipeline.build import build_run
from pipeline.judgement import poor_clone
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.toys import reach


def figures(successes: int, episodes: int) -> dict[str, Any]:
    flags = torch.arange(episodes).numpy() < successes
    return {
        "episodes": episodes,
        "success_once": successes / episodes,
        "success_once_ci95": list(wilson(flags)),
    }


@pytest.mark.parametrize(
    ("successes", "episodes", "shown", "poor"),
    [
        (0, 50, 1.0, True),
        (15, 50, 1.0, True),  # up to 44 % at 95 % confidence
        (20, 50, 1.0, False),  # up to 54 %
        (40, 50, 1.0, False),
        (0, 2, 1.0, False),  # two episodes say nothing: up to 66 %
        (5, 50, 0.1, False),  # as good as what it imitates
        (0, 50, 0.4, True),  # up to 7 %, half of theirs is 20 %
        (0, 50, None, True),
    ],
)
def test_a_clone_is_poor_well_below_half_of_its_demonstrations(
    successes: int, episodes: int, shown: float | None, poor: bool
):
    assert (poor_clone(figures(successes, episodes), shown, Recipe()) is not None) == poor


def test_nothing_is_said_where_a_task_tells_no_success():
    assert poor_clone({"episodes": 50, "success_once": None}, 1.0, Recipe()) is None


@pytest.mark.parametrize(
    ("error", "other"),
    [("nll", "fixed_width"), ("mse", "fixed_width"), ("fixed_width", "nll")],
)
def test_the_line_names_figures_and_remedies(error: str, other: str):
    recipe = Recipe().changed(loss={"imitation": error}, bc={"updates": 2000})
    line = poor_clone(figures(5, 50), 0.96, recipe)
    assert line is not None
    assert "\n" not in line
    assert "10% of 50 episodes succeed, 96% of its demonstrations do" in line
    assert f"loss.imitation={other}" in line
    assert "bc.updates (now 2000)" in line


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "reach.h5"
    reach.record(path, episodes=20)
    return path


def run_on(demos: Path, folder: Path, *overrides: str) -> Run:
    recipe = compose(
        "variant=bc_sac", "preset=smoke", f"task.name='{reach.__file__}'",
        f"demos.source='{demos}'", f"cache_dir='{folder / 'cache'}'", "bc.updates=100",
        "demos.limit=20", "collector.total_frames=40", "collector.frames_per_batch=20",
        "evaluation.interval=40", "optim.actor_delay=0",
        "evaluation.interval_episodes=40", "evaluation.batch=40", *overrides,
    )  # fmt: skip
    return build_run(recipe, folder / "run")


def rows(run: Run) -> list[dict[str, Any]]:
    text = (run.run_dir / "learning_curve.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines()]


def test_a_clone_that_learned_nothing_is_warned_of(
    recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    """At a rate of 0; it is the row of 0 frames, before any update."""
    run = run_on(recorded, tmp_path, "bc.lr=0")
    run.train()
    (line,) = [m for m in caplog.messages if m.startswith("a poor clone")]
    assert "100% of its demonstrations do" in line
    first, last = rows(run)
    assert (first["frames"], first["actor_updates"]) == (0, 0)
    assert last["frames"] == 40
    assert last["actor_updates"] > 0


def test_a_good_clone_is_not(recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    run = run_on(recorded, tmp_path, "bc.lr=1e-2", "bc.updates=300", "actor.hidden=[64]")
    run.train()
    assert rows(run)[0]["success_once"] > 0.5
    assert not any("poor clone" in message for message in caplog.messages)


@pytest.mark.parametrize(
    ("override", "frames"),
    [
        ("evaluation.interval=0", None),  # nothing is to be evaluated
        ("pretrain=false", [20, 40]),  # no clone
    ],
)
def test_a_run_without_a_clone_or_evaluations_judges_nothing(
    override: str, frames: list[int] | None, recorded: Path, tmp_path: Path
):
    run = run_on(recorded, tmp_path, override)
    run.train()
    curve = run.run_dir / "learning_curve.jsonl"
    assert curve.exists() == (frames is not None)
    assert frames is None or [row["frames"] for row in rows(run)] == frames


def test_the_judgement_changes_nothing_of_what_is_learned(recorded: Path, tmp_path: Path):
    learned = []
    for interval in ("0", "40"):
        folder = tmp_path / interval
        run = run_on(recorded, folder, f"evaluation.interval={interval}")
        run.train()
        learned.append(torch.cat([p.detach().view(-1) for p in run.actor.parameters()]))
    assert torch.equal(*learned)
