"""What ``make eval`` leaves beside its summary: a row per episode, a row per control step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from envs import Task
from envs.adroit.starts import placement_of
from envs.demonstrations.schema import StartKey
from envs.door.definition import TASK
from envs.door.hand import DOOR, DOOR_POSITION
from pipeline.act.metrics import Rollouts, summarise
from pipeline.build import build_run
from pipeline.cli import app
from pipeline.files.run_files import EVALUATION, RunDirectoryError
from pipeline.results.evaluation_files import (
    SUM,
    RunEvaluation,
    episode_columns,
    load_columns,
    load_evaluation,
    progress_columns,
)
from tests.pipeline.results.evaluated import evaluated, evaluation_of
from tests.pipeline.toys import tiny_config, where

NAN = float("nan")
RESULTS = Path(__file__).parents[3] / "docs" / "results"
PUBLISHED = sorted(RESULTS.glob("rows/*/seed*.json"))


def rollouts() -> Rollouts:
    """Three episodes: one succeeds at step 2 and loses it, one succeeds at its end, one ends."""
    return Rollouts(
        returns=np.array([1.5, 2.0, -3.0]),
        lengths=np.array([3, 3, 1]),
        success=np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]], dtype=bool),
        progress=np.array([[0.1, 0.9, 0.5], [0.2, 0.3, 0.7], [0.0, NAN, NAN]], dtype=np.float32),
        stages={
            "near": np.array([True, False, False]),
            "there": np.array([True, True, False]),
        },
    )


def bare() -> Task:
    return Task(name="bare", make_env=TASK.make_env)


def test_each_episode_has_its_own_figures():
    found = episode_columns(bare(), rollouts(), seed=0)
    assert found["episode"] == [0, 1, 2]
    assert found["return"] == [1.5, 2.0, -3.0]
    assert found["steps"] == [3, 3, 1]
    assert found["success_once"] == [1, 1, 0]
    assert found["success_at_end"] == [0, 1, 0]
    assert found["steps_to_success"] == [2, 3, None]
    assert found["steps_in_success"] == [1, 1, 0]
    assert found["progress_max"] == pytest.approx([0.9, 0.7, 0.0])
    assert found["progress_at_end"] == pytest.approx([0.5, 0.7, 0.0])
    # The furthest of the task's stages, also where an earlier one was left out.
    assert found["stage"] == ["there", "there", "none"]


def test_rows_and_summary_say_the_same():
    found, summary = episode_columns(bare(), rollouts(), seed=0), summarise(rollouts())
    assert np.mean(found["return"]) == summary.return_mean
    assert np.mean(found["success_once"]) == summary.success_once
    assert np.mean(found["success_at_end"]) == summary.success_at_end
    assert np.mean(found["steps_in_success"]) / 3 == pytest.approx(summary.success_share)
    assert np.median([s for s in found["steps_to_success"] if s]) == summary.steps_to_success_median


def test_a_task_that_tells_nothing_has_returns_and_lengths():
    told = Rollouts(np.array([1.0]), np.array([4]))
    assert list(episode_columns(bare(), told, seed=0)) == ["episode", "return", "steps"]
    assert progress_columns(told) == {}


def test_starts_are_those_of_the_task_s_list():
    found = episode_columns(TASK, rollouts(), seed=7)
    for axis, name in enumerate("xyz"):
        stood = [placement_of(DOOR, 7, door, 0)[DOOR_POSITION][axis] for door in range(3)]
        assert found[f"start.door_position.{name}"] == stood


def test_axes_must_name_every_entry():
    with pytest.raises(ValueError, match="place has 3 entries and 2 axes"):
        StartKey("place", 3, axes=("x", "y"))


def test_progress_is_over_the_episodes_that_still_run():
    found = progress_columns(rollouts())
    assert found["step"] == [1, 2, 3]
    assert found["running"] == [3, 2, 2]
    # Step 1: 0.1, 0.2 and 0; its median 0.1. Step 2: 0.9 and 0.3, the third episode is over.
    assert found["q50"] == pytest.approx([0.1, 0.6, 0.6])
    assert found["q10"][1] == pytest.approx(0.36)  # 0.3 + 0.1 * 0.6


def test_tables_come_back_as_they_were(tmp_path: Path):
    columns = episode_columns(TASK, rollouts(), seed=7)
    RunEvaluation({}, columns, {}).write(tmp_path / EVALUATION)
    found = load_columns(tmp_path / "episodes.csv")
    assert list(found) == list(columns)
    for name in columns:
        if name == "stage":
            assert found[name] == columns[name]
        else:  # nine digits
            assert [v is None for v in found[name]] == [v is None for v in columns[name]]
            known = [(a, b) for a, b in zip(found[name], columns[name], strict=True) if a]
            assert all(a == pytest.approx(b, rel=1e-8) for a, b in known)
    assert not (tmp_path / "progress.csv").exists()


def test_another_summary_has_tables_of_its_own(tmp_path: Path):
    columns = {"episode": [0]}
    RunEvaluation({}, columns, {}).write(tmp_path / "greedy.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["greedy.episodes.csv", "greedy.json"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"episodes.csv does not exist; make it with: make eval RUN="),
        ("episode,return\n0,1.0\n1\n", "episodes.csv is damaged"),
        ("episode,return\n0,much\n", "damaged .*much"),
        ("", "episodes.csv is damaged"),
    ],
)
def test_a_table_that_cannot_be_read_is_named(tmp_path: Path, text: str | None, message: str):
    if text is not None:
        (tmp_path / "episodes.csv").write_text(text)
    with pytest.raises(RunDirectoryError, match=message):
        load_columns(tmp_path / "episodes.csv")


HOSTILE = (
    ({"return_mean": 10**400}, "its return_mean is too large for a float"),
    ({"return_mean": float("inf")}, "its return_mean is inf"),
    ({"own": {"deep": [10**400]}}, r"its own\.deep is too large for a float"),
    ({"return_mean": "abc"}, "its return_mean is 'abc': .* valid number"),
    ({"episodes": [1]}, r"its episodes is \[1\]: .* valid integer"),
    ({"episodes": 0}, "its episodes is 0: .* greater than or equal to 1"),
    ({"episodes": 10**15}, "its episodes is 10+: .* less than or equal to 10000000"),
    ({"episodes": None}, "its episodes is None: .* valid integer"),
    ({"success_once": 7}, r"its success_once is 7: .* less than or equal to 1"),
    ({"stages": [1]}, r"its stages is \[1\]: .* valid dictionary\)"),
    ({"stages": {"near": None}}, r"its stages\.near is None: .* valid number"),
    ({"likeness": {"to": "x"}}, r"it has no likeness\.of_demonstrations"),
    ({"strategies": 3}, r"its strategies is 3: .* valid dictionary\)"),
)


@pytest.mark.parametrize(("wrong", "message"), HOSTILE, ids=lambda of: f"{of!s:.40}")
def test_an_evaluation_with_what_no_reader_could_use_is_named_with_its_key(
    tmp_path: Path, wrong: dict[str, Any], message: str
):
    path = changed(evaluated(tmp_path / "run") / EVALUATION, wrong)
    with pytest.raises(RunDirectoryError, match=message) as refused:
        load_evaluation(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"versions": 3}, r"made_from\.versions is 3: .* valid dictionary\)"),
        ({"versions": {"git": 3}}, r"made_from\.versions\.git is 3: .* valid string"),
        ({"seed": "one"}, r"made_from\.seed is 'one': .* valid integer"),
        ({"variant": None}, r"made_from\.variant is None: .* valid string"),
        ({"overrides": [1]}, r"made_from\.overrides\.0 is 1: .* valid string"),
    ],
)
def test_so_is_one_with_an_origin_that_no_reader_could_use(
    tmp_path: Path, wrong: dict[str, Any], message: str
):
    path = evaluated(tmp_path / "run") / EVALUATION
    origin = json.loads(path.read_text())["made_from"]
    with pytest.raises(RunDirectoryError, match=message):
        load_evaluation(changed(path, {"made_from": origin | wrong}))


def test_a_figure_of_the_task_s_own_is_a_number_or_not_told():
    told = evaluation_of({}, share_gt_1_35=1, angle_mean_deg=None, stages={"near": 0.5})
    assert told.figure("share_gt_1_35") == 1.0
    assert told.figure("angle_mean_deg") is None
    assert told.figure("nothing") is None
    with pytest.raises(ValueError, match=r"runs/x: its evaluation's stages is \{.*make eval"):
        told.figure("stages")


def test_a_figure_that_the_door_called_otherwise_has_its_name_of_today():
    key = "steps_to_success_median"
    assert evaluation_of({}, steps_to_open_median=41.0).figure(key) == 41.0
    both = evaluation_of({}, steps_to_open_median=41.0, steps_to_success_median=60.0)
    assert both.figure(key) == 60.0


def changed(path: Path, values: dict[str, Any]) -> Path:
    """The evaluation with other values, as from before there were checksums."""
    content = json.loads(path.read_text()) | values
    content.pop(SUM)
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_published_evaluation_can_be_read(path: Path):
    assert load_evaluation(path).episodes > 0


def test_make_eval_writes_them_beside_the_summary(tmp_path: Path, demos: Path):
    config = tiny_config("bc", tmp_path, demos, "torch_threads=1")
    build_run(config, where(config)).train()
    run = where(config)
    result = CliRunner().invoke(app, ["eval", str(run), "--episodes", "3"])
    assert result.exit_code == 0, result.output
    summary = json.loads((run / EVALUATION).read_text())
    episodes = load_columns(run / "episodes.csv")
    assert len(episodes["episode"]) == 3
    assert np.mean(episodes["return"]) == pytest.approx(summary["return_mean"])
    assert len(load_columns(run / "progress.csv")["step"]) == max(episodes["steps"])
    assert len(summary["made_from"]["demos_sha256"]) == 64
