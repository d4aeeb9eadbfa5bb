"""The weights of a run's best evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from configs import compose
from pipeline.best import BEST, BestWeights, better_before
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.curves import read_lines
from pipeline.files.run_files import CONFIG, LEARNING_CURVE, as_json
from pipeline.policy import WEIGHTS
from pipeline.results.run_cells import find_runs
from tests.pipeline.toys import built, tiny_config, where


def figures(success: float | None, value: float) -> dict[str, float | None]:
    return {"success_once": success, "return_mean": value}


@pytest.mark.parametrize(
    ("found", "kept"),
    [
        ([figures(0.5, 10.0), figures(0.4, 99.0)], [1.0, 1.0]),  # success counts first
        ([figures(0.5, 10.0), figures(0.5, 20.0)], [1.0, 2.0]),  # then the return
        ([figures(0.5, 10.0), figures(0.5, 10.0)], [1.0, 1.0]),  # the first of two alike
        ([figures(0.5, 10.0), figures(0.6, 1.0), figures(0.55, 50.0)], [1.0, 2.0, 2.0]),
        ([figures(None, -5.0), figures(None, -4.0)], [1.0, 2.0]),  # a task without success
    ],
)
def test_weights_are_kept_when_an_evaluation_beats_all_before(
    tmp_path: Path, found: list[dict[str, float]], kept: list[float]
):
    policy = torch.nn.Linear(1, 1, bias=False)
    best = BestWeights(compose("variant=sac", "preset=smoke"), policy, tmp_path)
    held = []
    for number, one in enumerate(found, start=1):
        policy.weight.data.fill_(number)
        best.offer(number, one, found[: number - 1])
        held.append(load_file(tmp_path / BEST / WEIGHTS)["weight"].item())
    assert held == kept


def curve(folder: Path, *rows: dict[str, float | None]) -> Path:
    lines = [as_json({"frames": 100 * i, **row}) + "\n" for i, row in enumerate(rows)]
    (folder / LEARNING_CURVE).write_text("".join(lines))
    return folder


def test_a_run_that_ends_worse_says_what_was_better(tmp_path: Path):
    curve(tmp_path, figures(0.5, 1.0), figures(0.9, 2.0), figures(0.7, 3.0))
    assert better_before(tmp_path) == ""  # nothing was kept
    (tmp_path / BEST).mkdir()
    line = better_before(tmp_path)
    assert "success 90 %, return 2, after 100" in line
    assert f"RUN={tmp_path / BEST}" in line
    assert better_before(curve(tmp_path, figures(0.5, 1.0), figures(0.9, 2.0))) == ""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    """A run that is evaluated often; its policy gets worse at once with so large a rate."""
    recipe = tiny_config(
        "bc_sac",
        tmp_path_factory.mktemp("best"),
        demos,
        "collector.total_frames=100",
        "evaluation.interval=20",
        "evaluation.interval_episodes=3",
        "optim.actor_lr=0.1",
    )
    built(recipe).train()
    return where(recipe)


def test_they_are_those_of_the_best_row(finished: Path):
    """What lies there is evaluated like any run, and gives what the curve says."""
    rows = read_lines(finished / LEARNING_CURVE)
    best = max(rows, key=lambda row: (row["success_once"], row["return_mean"]))
    assert best["frames"] < rows[-1]["frames"]  # else this would show nothing
    again = evaluate_run(finished / BEST, ["env.num_threads=1"], episodes=3)
    assert again["return_mean"] == best["return_mean"]
    assert again["made_from"]["frames"] == best["frames"]
    assert again["made_from"]["simulator_steps"] == best["simulator_steps"]


def test_they_are_no_run_of_their_own(finished: Path):
    assert (finished / BEST / CONFIG).is_file()
    assert find_runs([finished]) == [finished]
    assert find_runs([finished / BEST]) == [finished / BEST]  # named, they are


def test_nothing_is_kept_where_that_is_turned_off(tmp_path: Path, demos: Path):
    recipe = tiny_config("sac", tmp_path, demos, "evaluation.keep_best=false")
    built(recipe).train()
    assert read_lines(where(recipe) / LEARNING_CURVE)
    assert not (where(recipe) / BEST).exists()
