"""The tables over tasks and the curves of methods: from published cells, numbers by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from docs.site import cells, curves, task_tables
from docs.site.page import Page
from docs.site.places import DOCS
from pipeline.results.cells import CONDITIONS, Cell, save_cells
from pipeline.results.evaluation import Evaluation
from pipeline.results.runs import EvaluatedRun

OURS = ("door", "hammer", "pen", "relocate")
Publish = Callable[..., None]


def cell(
    task: str, row: str, seed: int = 0, reward: str = "dense", once: float | None = 0.9,
    counted: bool = True, **told: Any,
) -> Cell:  # fmt: skip
    """A run of 100 episodes with a curve of two points."""
    evaluation = {
        "episodes": 100,
        "return_mean": 10.0,
        "return_std": 5.0,
        "success_once": once,
        "success_at_end": None if once is None else 0.5,
        "steps_to_success_median": None if once is None else 41.0,
        "success_share": None if once is None else 0.25,
        "made_from": {
            "run": "r", "demos": "d", "variant": row, "seed": seed, "frames": 100, "bc_weight": 0.5
        },
    }  # fmt: skip
    conditions = {
        "preset": "table", "frames": 100, "updates": 40, "simulator_steps": 1130, "wall_s": 600.0,
        "demonstrations": 25, "demonstrations_by": "robot", "demonstrations_multiplied": True,
    }  # fmt: skip
    curve = tuple(
        {
            "frames": frames,
            "simulator_steps": frames + 1030 if counted else None,
            "wall_s": 6.0 * frames,
            "success_once": None if once is None else score,
            "return_mean": score,
        }
        for frames, score in ((0, 0.0), (100, 0.9))
    )
    run = EvaluatedRun(Path("run"), Evaluation.of(evaluation | told), curve)
    return Cell(task, reward, row, dict.fromkeys(CONDITIONS) | conditions, run)


def forget() -> None:
    cells.listed.cache_clear()
    cells.published.cache_clear()
    cells.reference.cache_clear()


@pytest.fixture
def publish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Publish]:
    """Makes the site believe that only these cells are published."""
    monkeypatch.setattr(cells, "RESULTS", tmp_path)
    monkeypatch.setattr(curves, "FIGURES", tmp_path / "figures")
    (tmp_path / "tasks").mkdir()

    def published(*made: Cell) -> None:
        save_cells(made, tmp_path / "tasks" / "cells.parquet")
        forget()

    forget()
    yield published
    forget()


def section(task: str) -> list[list[str]]:
    """Cells of the lines of a task's tables, heads included."""
    part = task_tables.render().split(f"### {task}\n")[1].split("\n### ")[0]
    lines = [line for line in part.splitlines() if line.startswith("|") and "---" not in line]
    return [[text.strip() for text in line.strip("|").split("|")] for line in lines]


def test_dense_and_sparse_stand_beside_each_other_and_what_is_missing_is_a_dash(publish: Publish):
    publish(cell("hammer", "bc"), cell("pen", "best", reward="sparse", once=1.0))
    head, bc, best, _, _, _ = section("hammer")
    assert head[1:4] == ["seeds, dense / sparse", "success once, dense", "success once, sparse"]
    # Wilson's interval of 90 in 100 (z = 1.96): (90 + 1.92 -+ 1.96 sqrt(9 + 0.96)) / 103.84.
    assert bc[:4] == ["`bc`", "1 / -", "90.0 % [82.6, 94.5]", "-"]
    # The normal one of the return: 10 -+ 1.96 * 5 / sqrt(100).
    assert bc[6:] == ["10.0 [9.0, 11.0]", "-"]
    # Rows of the other tasks are told as missing.
    assert best == ["`best`", "- / -", *["-"] * 6]
    assert section("pen")[2][:4] == ["`best`", "- / 1", "-", "100.0 % [96.3, 100.0]"]


def test_what_a_cell_cost_stands_below(publish: Publish):
    none: dict[str, Any] = {"words": {}, "thresholds": {}, "sensitivity": {}}
    ways = {"shares": {"held": 0.25, "grasp": 0.75}, **none}
    publish(cell("hammer", "bc", strategies=ways), cell("hammer", "bc", reward="sparse"))
    head, line = section("hammer")[2:]
    assert dict(zip(head, line, strict=True)) == {
        "row": "`bc`",
        "steps to success, dense / sparse": "41.0 / 41.0",
        "share of the horizon in success, dense / sparse": "25.0 % / 25.0 %",
        "simulator steps, dense / sparse": "1,130 / 1,130",
        "frames, dense / sparse": "100 / 100",
        "updates, dense / sparse": "40 / 40",
        "wall time, min, dense / sparse": "10.0 / 10.0",
        "preset": "`table`",
        "demonstrations": "25, robot, multiplied",
        "how, mostly": "grasp 75 % / -",
    }


def test_somebody_s_policy_stands_below_ours(publish: Publish, tmp_path: Path):
    publish(cell("hammer", "bc"))
    figures = dict(cell("hammer", "bc", once=1.0).run.evaluation.content)
    (tmp_path / "tasks" / "reference.json").write_text(
        json.dumps({"tasks": {"hammer": {"sparse": figures}}})
    )
    lines = section("hammer")
    assert lines[2][:4] == ["DAPG's policy", "", "-", "100.0 % [96.3, 100.0]"]
    assert lines[5][:4] == ["DAPG's policy", "- / 41.0", "- / 25.0 %", "-"]
    assert len(lines[5]) == len(lines[4])


@pytest.mark.parametrize(
    ("scores", "told"),
    [
        ([0.2, 0.4], "30.0 %"),  # two seeds: their mean, and no interval
        ([0.1, 0.4, 0.4], "30.0 % ["),  # a quarter of three is none
        ([0.0, 0.2, 0.3, 0.4, 1.0], "30.0 % ["),  # the best and the worst are left out
    ],
)
def test_seeds_of_a_cell_become_one_number(publish: Publish, scores: list[float], told: str):
    publish(*(cell("hammer", "bc", seed, once=score) for seed, score in enumerate(scores)))
    line = section("hammer")[1]
    assert line[1] == f"{len(scores)} / -"
    assert line[2].startswith(told)
    assert ("[" in line[2]) == ("[" in told)
    if "[" in told:
        low, high = (float(part) for part in line[2].split("[")[1].strip("]").split(","))
        assert 100 * min(scores) <= low < 30.0 < high <= 100 * max(scores)


def test_a_seed_that_never_succeeds_leaves_no_steps_to_success(publish: Publish):
    publish(cell("hammer", "bc", once=0.0, steps_to_success_median=None))
    assert section("hammer")[3][1] == "- / -"


def test_an_environment_of_others_has_its_own_reward_and_no_success(publish: Publish):
    publish(cell("gymnasium:Hopper-v5", "sac", reward="own", once=None))
    head, line, below, _ = section("gymnasium:Hopper-v5")
    assert (head, line) == (["row", "seeds", "return"], ["`sac`", "1", "10.0 [9.0, 11.0]"])
    assert "steps to success" not in below


def test_a_task_without_a_cell_names_the_command(publish: Publish):
    publish(cell("gymnasium:Hopper-v5", "sac", reward="own", once=None))
    text = task_tables.render().split("### pen\n")[1].split("\n### ")[0]
    assert text.strip() == "No cell is published yet: `make rows TASK=pen` makes some."


def test_tasks_stand_together_where_a_row_has_all_of_them(publish: Publish):
    of_bc = zip(OURS, (0.0, 0.4, 0.6, 1.0), strict=True)
    some = [cell(task, "best") for task in OURS[1:]]
    publish(*(cell(task, "bc", once=score) for task, score in of_bc), *some)
    lines = task_tables.aggregate().splitlines()[2:]
    # The middle half of four: (0.4 + 0.6) / 2; one seed, so no interval.
    assert lines == ["| `bc` | dense | 1 | 100 | 1,130 | 50.0 % | 0.0 % |"]
    assert task_tables.complete("sparse") == {}


def test_where_tasks_have_different_numbers_of_seeds_the_first_count(publish: Publish):
    publish(*(cell(task, "bc") for task in OURS), cell("door", "bc", 1, once=0.0))
    assert task_tables.complete("dense")["bc"].tolist() == [[0.9] * 4]


def test_no_row_has_every_task_yet(publish: Publish):
    publish(cell("hammer", "bc"))
    assert task_tables.aggregate().startswith("No row has a cell at each of door, hammer, pen, rel")
    page = Page(DOCS / "results" / "tasks" / "README.md", {}, "")
    assert "needs a row with a cell at each" in curves.profiles(page)


def test_a_method_shows_its_own_cells(publish: Publish):
    publish(cell("hammer", "bc"), cell("hammer", "best"))
    (line,) = task_tables.rows_of(["bc"]).splitlines()[2:]
    assert line.startswith("| `hammer` | dense | `bc` | 1 | 100 | 1,130 | 90.0 % [82.6, 94.5] | ")
    assert line.endswith("| 10.0 [9.0, 11.0] | 41.0 |")
    assert "`make rows TASK=hammer ROWS=loki` makes one" in task_tables.rows_of(["loki"])


def test_a_method_shows_its_curves(publish: Publish, tmp_path: Path):
    publish(cell("hammer", "bc"), cell("pen", "bc"), cell("pen", "sac"))
    page = Page(DOCS / "methods" / "bc.md", {"variants": ["bc"]}, "")
    link = curves.of_method(page)
    assert link.startswith("![learning curves over environment frames, simulator steps, wall time")
    path = tmp_path / "figures" / "bc_curves.svg"
    drawn = path.read_text()
    assert "hammer, dense; pen, dense](" in link
    words_of_axes = ("environment frames", "simulator steps", "wall time (min)")
    for words in ("hammer, dense", "pen, dense", "bc, 1 seed", "success once", *words_of_axes):
        assert f">{words}<" in drawn
    assert drawn.count(">hammer, dense<") == 3, "a panel for each axis"
    assert ">sac" not in drawn
    curves.of_method(page)
    assert path.read_text() == drawn, "the same data, the same file"
    without = Page(DOCS / "methods" / "loki.md", {"variants": ["loki"]}, "")
    assert curves.of_method(without) == "No learning curve of this method is published yet."


def test_a_curve_of_before_steps_were_counted_is_named_and_not_drawn(
    publish: Publish, tmp_path: Path
):
    publish(cell("hammer", "bc", counted=False))
    curves.of_method(Page(DOCS / "methods" / "bc.md", {"variants": ["bc"]}, ""))
    drawn = (tmp_path / "figures" / "bc_curves.svg").read_text()
    assert drawn.count(">not counted:<") == 1
    assert drawn.count(">bc, 1 seed<") == 2


def test_a_profile_is_drawn_of_all_tasks(publish: Publish, tmp_path: Path):
    publish(*(cell(task, "bc") for task in OURS))
    page = Page(DOCS / "results" / "tasks" / "README.md", {}, "")
    assert curves.profiles(page).startswith("![share of runs above each share of success")
    assert ">dense: runs above a score<" in (tmp_path / "figures" / "profiles.svg").read_text()


def test_the_door_s_published_rows_are_cells_too():
    forget()
    row = cells.result("door", "dense", "bc_sac_1")
    assert row is not None
    assert [run.seed for run in row.runs] == [0, 1, 2, 3, 4]
    assert cells.condition("door", "dense", "bc_sac_1", "frames") == 100_000
    assert cells.condition("door", "dense", "bc_sac_1", "updates") is None  # older than the count
    assert cells.middle(row, task_tables.STEPS[0]) != "-"  # under the name of before
