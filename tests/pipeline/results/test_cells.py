"""The table over tasks: run directories in, one file out, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from typer.testing import CliRunner

from envs.door.paper import PAPER
from pipeline.cli import app
from pipeline.files.run_files import CONFIG, EVALUATION, LEARNING_CURVE, VERSIONS, RunDirectoryError
from pipeline.files.time_use import TIME_USE
from pipeline.results.cells import Cell, load_cells, merge_cells, save_cells, without_places
from pipeline.results.demonstrators import Demonstrators, demonstrators, read_listed
from pipeline.results.evaluation import MadeFrom
from pipeline.results.evaluation_files import save_evaluation
from pipeline.results.publish import has_tables
from pipeline.results.publish_cells import publish_cells, read_cells
from pipeline.results.rows import in_published_order, published_names
from pipeline.results.run_cells import find_runs, read_cell, row_of
from pipeline.results.run_tables import row_name
from tests.pipeline.results.evaluated import REVISION, evaluated, evaluation_of, made_from, recipe
from tests.pipeline.toys import write_demos

LISTED = {"b" * 64: Demonstrators("robot", 25)}
NO_WEIGHTS = "--no-policies"
"""These runs have none."""


def read(run_dir: Path) -> Cell:
    return read_cell(run_dir, LISTED)


def file_of(out: Path) -> Path:
    return out / "tasks" / "cells.parquet"


# ----------------------------------------------------------------------------------- round trip


def test_what_a_run_is_comes_from_its_files_and_not_from_its_folders(tmp_path: Path):
    run = evaluated(tmp_path / "door_sparse" / "best" / "seed7")
    assert read(run).keys == ("hammer", "dense", "bc_sac_1", 0)


@pytest.mark.parametrize(
    ("task", "demos", "row"),
    [
        ("relocate", {"multiply": {"enabled": True}}, "bc_sac_1"),
        ("relocate", {"limit": 5, "multiply": {"enabled": True}}, "bc_sac_1, 5 demonstrations"),
        ("relocate", {}, "bc_sac_1, not multiplied"),
        ("hammer", {}, "bc_sac_1"),
        ("tests/toys/reach.py", {"limit": 2}, "bc_sac_1, 2 demonstrations"),
    ],
)
def test_what_the_demonstrations_of_a_run_lack_is_part_of_its_row(task: str, demos: dict, row: str):
    assert row_of(recipe(task={"name": task}, demos=demos)) == row


def test_a_cell_that_is_published_is_read_as_it_was(tmp_path: Path):
    run = evaluated(tmp_path / "run")
    publish_cells([read(run)], tmp_path / "out", policies=False)
    (cell,) = load_cells(file_of(tmp_path / "out"))
    assert cell.keys == ("hammer", "dense", "bc_sac_1", 0)
    assert dict(cell.conditions) == {
        "preset": "table",
        "frames": 100,
        "updates": 40,
        "simulator_steps": 130,
        "wall_s": 12.5,
        "demonstrations": 25,
        "demonstrations_by": "robot",
        "demonstrations_multiplied": False,
        "torch_threads": 1,
        "env_threads": 1,
        "git": "a" * 40,
        "trained_with": REVISION,
    }
    assert cell.run.evaluation.success_once == 0.9
    assert cell.run.evaluation.success_share == 0.25
    assert cell.run.evaluation.made_from.demos == "demos.pickle"
    assert [row["return_mean"] for row in cell.run.curve] == [1.0, 3.0]
    assert cell.run.curve[1]["stages"] == {"near": 1.0}


def test_tasks_with_other_stages_and_rewards_share_the_file(tmp_path: Path):
    runs = [
        evaluated(tmp_path / "a", stages={"near": 1.0}),
        evaluated(tmp_path / "b", recipe(env={"reward": "sparse"}), stages={"far": 0.0}),
        evaluated(tmp_path / "c", recipe(task={"name": "gymnasium:Hopper-v5"}), success_once=None),
    ]
    publish_cells([read(run) for run in runs], tmp_path / "out", policies=False)
    found = {cell.keys[:2]: cell.run.evaluation for cell in load_cells(file_of(tmp_path / "out"))}
    assert found["hammer", "dense"].stages == {"near": 1.0}
    assert found["hammer", "sparse"].stages == {"far": 0.0}
    assert found["gymnasium:Hopper-v5", "own"].success_once is None


def test_the_file_names_no_place_on_this_machine(tmp_path: Path):
    task = tmp_path / "my tasks" / "reach.py"
    run = evaluated(tmp_path / "run", recipe(task={"name": f"{task}:TASK"}))
    publish_cells([read(run)], tmp_path / "out", policies=False)
    (cell,) = load_cells(file_of(tmp_path / "out"))
    assert cell.task == "reach.py:TASK"
    told = json.dumps([cell.conditions, cell.run.published()])
    assert str(tmp_path) not in told
    assert "/somewhere" not in told
    assert without_places({"a": ["/x/y.h5", "b/c", 1]}) == {"a": ["y.h5", "b/c", 1]}


def test_cells_are_added_and_a_seed_that_is_run_again_is_replaced(tmp_path: Path):
    out = tmp_path / "out"
    publish_cells([read(evaluated(tmp_path / "a"))], out, policies=False)
    again = read(evaluated(tmp_path / "b", return_mean=5.0))
    other = read(evaluated(tmp_path / "c", recipe(seed=1)))
    publish_cells([again, other], out, policies=False)
    found = {cell.run.seed: cell.run.evaluation.return_mean for cell in load_cells(file_of(out))}
    assert found == {0: 5.0, 1: 3.0}


def test_the_wall_time_of_a_run_that_was_killed_is_that_of_its_curve(tmp_path: Path):
    run = evaluated(tmp_path / "run")
    (run / TIME_USE).unlink()
    assert read(run).conditions["wall_s"] == 9.0


@pytest.mark.parametrize(
    ("variant", "weight", "row"),
    [("bc_sac", 1.0, "bc_sac_1"), ("bc_sac", 0.1, "bc_sac_0.1"), ("best", 0.35, "best"),
     ("da_sac", 0.0, "da_sac"), ("bc_sac", None, "bc_sac")],
)  # fmt: skip
def test_a_row_of_several_weights_is_named_with_its_own(
    variant: str, weight: float | None, row: str
):
    assert row_name(variant, weight, ["da_sac", "bc_sac_10", "bc_sac_1", "best"]) == row


# --------------------------------------------------------------------------------- what is refused


def judged(run: Path, **changes: object) -> None:
    """Writes the evaluation again with another origin."""
    content = json.loads((run / EVALUATION).read_text())
    save_evaluation(run / EVALUATION, content | {"made_from": made_from(recipe(), run) | changes})


def further(run: Path) -> None:
    with (run / LEARNING_CURVE).open("a") as file:
        file.write('{"frames": 120}\n')


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no evaluation": (lambda run: (run / EVALUATION).unlink(), "does not exist.* make eval RUN="),
    "older than its curve": (further, "older than the run, of 100 .* has 120; .* make eval RUN="),
    "older than its checkpoint": (
        lambda run: (run / "checkpoints" / "checkpoint-000000000140").mkdir(),
        "older than the run, of 100 .* has 140",
    ),
    "of weights": (lambda run: judged(run, checkpoint="policy.safetensors"), "is no checkpoint"),
    "of another seed": (lambda run: judged(run, seed=3), "of seed 3 and its config.yaml of 0"),
    "of another task": (lambda run: judged(run, task="pen"), "of task 'pen' and .* of 'hammer'"),
    "by another reward": (lambda run: judged(run, reward="sparse"), "of reward 'sparse'"),
    "evaluated with changes": (
        lambda run: judged(run, versions=REVISION | {"git_dirty": True}),
        "was evaluated with changes that no revision holds.*--unclean",
    ),
    "trained with changes": (
        lambda run: (run / VERSIONS).write_text(json.dumps(REVISION | {"git_dirty": True})),
        "was trained with changes",
    ),
    "of no revision": (
        lambda run: (run / VERSIONS).write_text(json.dumps(REVISION | {"git": None})),
        "was trained outside any revision",
    ),
    "no versions": (lambda run: (run / VERSIONS).unlink(), "versions.json cannot be read .No such"),
    "damaged versions": (lambda run: (run / VERSIONS).write_text("["), "versions.json cannot be"),
    "damaged time use": (lambda run: (run / TIME_USE).write_text("[]"), "time_use.json is damaged"),
    "damaged configuration": (lambda run: (run / CONFIG).write_text("a"), "config.yaml holds no"),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_run_that_cannot_be_published_is_named_with_the_remedy(broken: str, tmp_path: Path):
    run = evaluated(tmp_path / "run")
    harm, told = BROKEN[broken]
    harm(run)
    with pytest.raises(RunDirectoryError, match=told) as error:
        read(run)
    assert str(run) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_run_that_is_not_trained_to_its_end_is_refused(tmp_path: Path):
    run = evaluated(tmp_path / "run", recipe(collector={"total_frames": 200}))
    with pytest.raises(RunDirectoryError, match=r"as far as 100 of 200 .* make train RESUME="):
        read(run)


def test_changes_that_no_revision_holds_are_published_when_it_is_said(tmp_path: Path):
    run = evaluated(tmp_path / "run")
    (run / VERSIONS).write_text(json.dumps(REVISION | {"git_dirty": True}))
    cell = read_cell(run, LISTED, unclean=True)
    assert cell.conditions["trained_with"]["git_dirty"] is True


def test_nothing_is_written_where_one_run_is_refused(tmp_path: Path):
    evaluated(tmp_path / "runs" / "a")
    (evaluated(tmp_path / "runs" / "b", recipe(seed=1)) / EVALUATION).unlink()
    done = CliRunner().invoke(
        app, ["results", str(tmp_path / "runs"), "--out", str(tmp_path / "o")]
    )
    assert isinstance(done.exception, RunDirectoryError)
    assert not (tmp_path / "o").exists()


def test_two_runs_of_one_cell_are_refused(tmp_path: Path):
    cells = [read(evaluated(tmp_path / name)) for name in ("one", "two")]
    with pytest.raises(
        RunDirectoryError, match=r"one and .*two are both seed 0 of row bc_sac_1 of h"
    ):
        merge_cells([], cells)


def test_a_cell_of_two_recipes_is_refused(tmp_path: Path):
    first = read(evaluated(tmp_path / "a"))
    second = read(evaluated(tmp_path / "b", recipe(seed=1, preset="paper")))
    with pytest.raises(
        RunDirectoryError,
        match="hammer, dense: row bc_sac_1: seed 0 has preset 'table', seed 1 has 'paper'; publish",
    ):
        merge_cells([first], [second])


def test_a_folder_without_runs_names_the_command(tmp_path: Path):
    with pytest.raises(RunDirectoryError, match=r"holds no run .*make rows"):
        find_runs([tmp_path])


def test_a_file_of_before_lacks_a_column(tmp_path: Path):
    cell = read(evaluated(tmp_path / "run"))
    conditions = {key: value for key, value in cell.conditions.items() if key != "updates"}
    save_cells([Cell(cell.task, cell.reward, cell.row, conditions, cell.run)], tmp_path / "c")
    with pytest.raises(RunDirectoryError, match="has no column 'updates'"):
        load_cells(tmp_path / "c")


# ---------------------------------------------------------------------------- who demonstrated


def asking(**told: str) -> MadeFrom:
    """What an evaluation was made from, as far as it tells demonstrations."""
    return evaluation_of(told).made_from


def test_a_recording_of_ours_says_that_a_robot_made_it_and_how_much(tmp_path: Path):
    source = write_demos(tmp_path / "demos.h5")
    asked = asking(demos=str(source), demos_sha256="c" * 64)
    assert demonstrators(asked, None, LISTED) == Demonstrators()  # its card does not tell
    with h5py.File(source, "r+") as file:
        file.attrs["card"] = json.dumps({"kept": 2})
    assert demonstrators(asked, None, LISTED) == Demonstrators("robot", 2)
    assert demonstrators(asking(demos=str(tmp_path / "gone.h5")), None, {}) == Demonstrators()


def test_the_first_so_many_of_a_listed_file_were_taken():
    asked = asking(demos="x.pickle", demos_sha256="b" * 64)
    assert demonstrators(asked, None, LISTED) == Demonstrators("robot", 25)
    assert demonstrators(asked, 10, LISTED) == Demonstrators("robot", 10)
    assert demonstrators(asked, 99, LISTED) == Demonstrators("robot", 25)


def test_a_list_with_a_wrong_entry_is_named(tmp_path: Path):
    path = tmp_path / "demonstrations.yaml"
    path.write_text("abc: {by: human, episodes: 3}\n")
    assert read_listed(path) == {"abc": Demonstrators("human", 3)}
    for entry in ("{by: alien, episodes: 3}", "{by: human}", "{by: human, episodes: 0}", "5"):
        path.write_text(f"abc: {entry}\n")
        with pytest.raises(
            RunDirectoryError, match=r"demonstrations\.yaml: abc must say by: human"
        ):
            read_listed(path)
    assert read_listed(tmp_path / "none.yaml") == {}


# ---------------------------------------------------------------------------------- make results


@pytest.mark.parametrize(
    ("task", "reward", "tables"),
    [("door", None, True), ("door", "dense", True), ("door", "sparse", False),
     ("hammer", None, False), ("gymnasium:Hopper-v5", None, False)],
)  # fmt: skip
def test_published_tables_are_of_the_door_and_its_own_reward(
    task: str, reward: str | None, tables: bool, tmp_path: Path
):
    evaluated(tmp_path / "row" / "seed0", recipe(task={"name": task}, env={"reward": reward}))
    assert has_tables(tmp_path) == tables


def test_runs_of_two_tasks_are_no_table_of_one(tmp_path: Path):
    for name in ("door", "hammer"):
        evaluated(tmp_path / name / "seed0", recipe(task={"name": name}))
    assert not has_tables(tmp_path)


def test_make_results_publishes_cells_of_several_folders(tmp_path: Path):
    out = tmp_path / "out"
    (out / "tasks").mkdir(parents=True)
    (out / "tasks" / "demonstrations.yaml").write_text(f"{'b' * 64}: {{by: human, episodes: 4}}")
    folders = [tmp_path / "one", tmp_path / "two"]
    evaluated(folders[0] / "bc" / "seed0")
    evaluated(folders[1] / "deeper" / "bc" / "seed0", recipe(env={"reward": "sparse"}))
    done = CliRunner().invoke(app, ["results", *map(str, folders), "--out", str(out), NO_WEIGHTS])
    assert done.exit_code == 0, done.output
    assert "hammer, sparse, bc_sac_1, 0" in done.output
    assert "2 of 2 cells" in done.output
    cells = load_cells(file_of(out))
    assert [cell.reward for cell in cells] == ["dense", "sparse"]
    assert {cell.conditions["demonstrations_by"] for cell in cells} == {"human"}
    assert read_cells(folders, out)[0].conditions["demonstrations"] == 4


# ---------------------------------------------------------------------------------- order of rows


def test_rows_stand_as_they_were_published_and_our_own_behind_them_by_name():
    published = ("sac", "bc", "bc_sac_1")
    names = ["mine", "bc_sac_1", "best", "sac", "bc"]
    assert in_published_order(names, published) == ["sac", "bc", "bc_sac_1", "best", "mine"]
    assert in_published_order(names, ()) == sorted(names)


def test_the_published_names_are_those_of_our_tasks():
    assert published_names() == tuple(PAPER.rows)
