"""``make report``: numbers worked out by hand, and what it says of runs that lack something."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.files.run_files import RunDirectoryError
from pipeline.machine import extras
from pipeline.report.build import build_report, write_report
from pipeline.report.page import Report, Section, Table, told_once
from pipeline.results.grouping import group
from pipeline.results.reading import read_runs
from pipeline.results.robustness import ROBUSTNESS, Ladder, Measured, Robustness
from tests.pipeline.report.making import curve, make_run


def reported(*paths: Path) -> Report:
    return build_report(group(read_runs(paths)))


def section(report: Report, key: str) -> Section:
    (found,) = (part for part in report.sections if part.key == key)
    return found


def line(report: Report, key: str, name: str, table: int = 0) -> dict[str, str]:
    """The line of a row by header."""
    shown = section(report, key).tables[table]
    (cells,) = (row for row in shown.rows if row[0] == name)
    return dict(zip(shown.headers, cells, strict=True))


def drawn(report: Report, key: str, title: str) -> list[dict[str, Any]]:
    """The traces of a chart."""
    (chart,) = (chart for chart in section(report, key).charts if chart.title == title)
    return json.loads(chart.figure)["data"]


@pytest.fixture
def two_seeds(tmp_path: Path) -> Report:
    """Of one recipe: 5 and 10 of 10 episodes succeed."""
    make_run(tmp_path / "a", seed=0, successes=5, points=curve(0.0, 0.2))
    make_run(tmp_path / "b", seed=1, successes=10, points=curve(0.0, 0.6))
    return reported(tmp_path / "a", tmp_path / "b")


# ------------------------------------------------------------------------------------ rows


def test_seeds_of_one_recipe_are_a_row(two_seeds: Report):
    found = line(two_seeds, "results", "dbc_sac")
    assert (found["seeds"], found["episodes"]) == ("2", "10")
    assert list(found)[:3] == ["row", "success", "success at the end"]  # all that a phone shows


def test_runs_of_other_recipes_are_called_after_what_differs(tmp_path: Path):
    paths = [
        make_run(tmp_path / "a", loss={"gamma": 0.9}),
        make_run(tmp_path / "b", loss={"gamma": 0.99}, device="cuda"),
    ]
    rows = group(read_runs(paths))
    assert [row.name for row in rows] == ["dbc_sac (loss.gamma=0.9)", "dbc_sac (loss.gamma=0.99)"]
    shown = section(build_report(rows), "differences").tables[0]
    assert shown.rows == [["loss.gamma", "0.9", "0.99"]]


def test_a_resumed_seed_stays_in_the_row_of_what_it_ended_as(tmp_path: Path):
    """The history of its directory is how it came to these settings, not another recipe."""
    change = {"frames": 300, "at": "2026-01-01", "changed": {"bc.updates": [300, 600]}}
    make_run(tmp_path / "a", seed=0, bc={"updates": 600})
    make_run(tmp_path / "b", seed=1, bc={"updates": 600}, history=[change])
    rows = group(read_runs([tmp_path / "a", tmp_path / "b"]))
    assert [(row.name, len(row.runs)) for row in rows] == [("dbc_sac", 2)]
    assert section(build_report(rows), "differences").absent == ["none"]


def test_long_values_are_shortened_in_a_name_and_names_stay_unlike(tmp_path: Path):
    paths = [make_run(tmp_path / name, loss={"own_terms": f"{'long' * 6}{name}"}) for name in "ab"]
    named = [row.name for row in group(read_runs(paths))]
    # 21 characters and three dots.
    first = "dbc_sac (loss.own_terms=longlonglonglonglongl...)"
    assert named == [first, f"{first} #2"]


def test_a_folder_of_seeds_is_a_row_of_its_name(tmp_path: Path):
    for seed in (0, 1, 10):
        make_run(tmp_path / "mine" / f"seed{seed}", seed=seed)
    (row,) = group(read_runs([tmp_path]))
    assert row.name == "mine"
    assert [run.told("seed") for run in row.runs] == [0, 1, 10]


def test_a_run_that_is_named_twice_counts_once(tmp_path: Path):
    run = make_run(tmp_path / "mine" / "seed0")
    assert len(read_runs([run, tmp_path / "mine", tmp_path])) == 1


def test_a_path_that_leads_to_no_run_is_named(tmp_path: Path):
    with pytest.raises(RunDirectoryError, match="nowhere is no run: name run directories"):
        read_runs([tmp_path / "nowhere"])


def test_runs_of_two_tasks_have_no_report(tmp_path: Path):
    make_run(tmp_path / "a")
    other = make_run(tmp_path / "b", task="other")
    with pytest.raises(ValueError, match=r"of one task, and these runs are of \['door', 'other'\]"):
        reported(tmp_path / "a", other)


# ------------------------------------------------------------------------------------ numbers


def test_intervals_of_several_seeds_are_over_seeds(two_seeds: Report, tmp_path: Path):
    # The paper's DBC-SAC opens 94.8 % beyond 1.35 rad, with a return of 966.7.
    found = line(two_seeds, "results", "dbc_sac")
    assert found["success"] == "75.0 % / 94.8 %", "of two seeds there is no interval"
    assert found["return"] == "7.5 / 966.7"
    make_run(tmp_path / "c", seed=2, successes=0)
    three = reported(*(tmp_path / name for name in "abc"))
    # Interquartile means of three draws of 0, 0.5 and 1; all three are the same in 1 of 9.
    assert line(three, "results", "dbc_sac")["success"] == "50.0 % [0.0, 100.0] / 94.8 %"


def test_the_interval_of_one_seed_is_over_its_episodes(tmp_path: Path):
    found = line(reported(make_run(tmp_path / "a", successes=5)), "results", "dbc_sac")
    # Wilson, 5 of 10: (0.5 + z2/20 +- z sqrt(0.025 + z2/400)) / (1 + z2/10), z = 1.96.
    assert found["success"] == "50.0 % [23.7, 76.3] / 94.8 %"
    # Returns 10 and 0, half each: deviation 5; 5 +- 1.96 * 5 / sqrt(10).
    assert found["return"] == "5.0 [1.9, 8.1] / 966.7"


def test_what_took_no_frames_is_a_level_line(tmp_path: Path):
    """Its curve counts updates, which are no place on an axis of frames."""
    make_run(tmp_path / "rl" / "seed0", points=curve(0.0, 0.3, 0.5))
    make_run(tmp_path / "clone" / "seed0", variant="bc", frames=0, points=curve(0.1, 0.4, 0.7, 0.8))
    traces = drawn(reported(tmp_path), "curves", "share that succeeds")
    (level,) = (trace for trace in traces if trace.get("name") == "clone")
    assert (level["x"], level["y"]) == ([0.0, 200.0], [0.8, 0.8])


def test_sections_without_anything_to_show_are_told_together(tmp_path: Path):
    for seed in range(8):
        make_run(tmp_path / "mine" / f"seed{seed}", seed=seed)
    report = reported(tmp_path)
    assert section(report, "films").empty
    assert not section(report, "results").empty
    page, text = report.html(), report.markdown()
    assert "<h2>Films</h2>" not in page
    assert page.index("<h2>Not shown</h2>") > page.index("<h2>Results</h2>")
    told = "all 8 runs: no film in the run"
    assert told in page
    assert f"- Films: {told}" in text


def test_those_that_lack_something_are_named_if_others_do_not():
    runs = [f"run{i}" for i in range(9)]
    assert told_once(dict.fromkeys(runs, "no film"), runs, "runs") == ["all 9 runs: no film"]
    assert told_once({"run0": "no film"}, ["run0"], "runs") == ["run0: no film"]
    eight = "run0, run1, run2, run3, run4, run5 and 2 more: no film"
    assert told_once(dict.fromkeys(runs[:8], "no film"), runs, "runs") == [eight]


def test_curves_are_means_over_seeds_with_the_published_number(two_seeds: Report):
    (mean,) = drawn(two_seeds, "curves", "share that succeeds")
    assert mean["x"] == [0.0, 100.0]
    assert mean["y"] == pytest.approx([0.0, 0.4])
    figure = json.loads(section(two_seeds, "curves").charts[0].figure)
    assert [shape["y0"] for shape in figure["layout"]["shapes"]] == [0.948]
    assert figure["layout"]["yaxis"]["range"] == [-0.02, 1.02]


def test_a_band_goes_there_and_back(tmp_path: Path):
    for seed, last in enumerate((0.2, 0.6, 0.4)):
        make_run(tmp_path / f"{seed}", seed=seed, points=curve(0.0, last))
    band, mean = drawn(reported(*tmp_path.iterdir()), "curves", "share that succeeds")
    assert mean["y"] == pytest.approx([0.0, 0.4])
    assert band["x"] == [0.0, 100.0, 100.0, 0.0]
    assert (band["mode"], mean["mode"]) == ("lines", "lines"), "no markers at the corners"
    assert band["y"] == pytest.approx([0.0, 0.6, 0.2, 0.0])


def counted(*success: float) -> list[dict[str, Any]]:
    """A learning curve that tells everything that the run has spent."""
    rows = curve(*success)
    return [{**row, "simulator_steps": row["frames"] + 500, "wall_s": 60.0 * n}
            for n, row in enumerate(rows)]  # fmt: skip


def test_curves_can_be_read_over_everything_that_a_run_costs(tmp_path: Path):
    make_run(tmp_path / "new" / "seed0", points=counted(0.0, 0.5))
    make_run(tmp_path / "older" / "seed0", points=curve(0.0, 0.2))
    report = reported(tmp_path)
    shown = section(report, "curves")
    assert shown.axes == {
        "frames": "environment frames",
        "simulator_steps": "simulator steps",
        "wall_s": "wall time (min)",
    }
    first = shown.charts[0]
    assert [trace["name"] for trace in json.loads(first.figure)["data"]] == ["new", "older"]
    (steps,) = json.loads(first.over["simulator_steps"])["data"]
    assert (steps["name"], steps["x"], steps["y"]) == ("new", [500.0, 600.0], [0.0, 0.5])
    (wall,) = json.loads(first.over["wall_s"])["data"]
    assert (wall["x"][-1], wall["y"][-1]) == (1.0, 0.5)
    lacking = "older: no curve over simulator steps, which not all runs of the row told"
    assert lacking in shown.absent


def test_without_another_axis_there_is_no_choice(two_seeds: Report):
    shown = section(two_seeds, "curves")
    assert shown.axes == {}
    assert not any(chart.over for chart in shown.charts)
    assert 'class="switch"' not in two_seeds.html()


def test_frames_and_simulator_steps_stand_beside_each_other(tmp_path: Path):
    run = make_run(tmp_path / "a")
    assert line(reported(run), "results", "dbc_sac")["simulator steps"] == "-"
    evaluation = json.loads((run / "evaluation.json").read_text())
    del evaluation["sha256"]
    evaluation["made_from"]["simulator_steps"] = 1540
    (run / "evaluation.json").write_text(json.dumps(evaluation))
    for table in range(3):
        found = line(reported(run), "results", "dbc_sac", table)
        assert (found["frames"], found["simulator steps"]) == ("40", "1,540")


def test_four_rows_a_panel(tmp_path: Path):
    for name in "abcde":
        make_run(tmp_path / name / "seed0")
    titles = [chart.title for chart in section(reported(tmp_path), "curves").charts]
    assert titles[:2] == ["share that succeeds (1 of 2)", "share that succeeds (2 of 2)"]
    first = json.loads(section(reported(tmp_path), "curves").charts[0].figure)["data"]
    assert [trace["name"] for trace in first] == ["a", "b", "c", "d"]


def test_a_row_has_its_colour_whatever_others_lack(tmp_path: Path):
    for name in "abc":
        make_run(tmp_path / name / "seed0")
    (tmp_path / "b" / "seed0" / "episodes.csv").unlink()
    report = reported(tmp_path)
    colours = [
        {trace["name"]: trace["line"]["color"] for trace in drawn(report, *which)}
        for which in (
            ("curves", "share that succeeds"),
            ("times", "success by step"),
            ("maps", "success over door_position.x"),
        )
    ]
    assert len(set(colours[0].values())) == 3
    assert colours[1] == colours[2] == {name: colours[0][name] for name in "ac"}


def test_episodes_are_counted_by_the_last_stage_they_reached(tmp_path: Path):
    found = line(reported(make_run(tmp_path / "a", successes=5)), "stages", "dbc_sac")
    assert found == {"row": "dbc_sac", "none": "40.0 %", "near": "10.0 %", "there": "50.0 %"}


def test_without_a_table_stages_come_from_the_summary(tmp_path: Path):
    run = make_run(tmp_path / "a", successes=5)
    (run / "episodes.csv").unlink()
    found = line(reported(run), "stages", "dbc_sac")
    assert found == {"row": "dbc_sac", "none": "40.0 %", "near": "10.0 %", "there": "50.0 %"}


def test_time_to_success_counts_all_episodes(two_seeds: Report):
    (trace,) = drawn(two_seeds, "times", "success by step")
    assert trace["x"] == [0, 1, 2, 3, 4]
    assert trace["y"] == [0.0, 0.0, 0.75, 0.75, 0.75]  # 15 of 20 from step 2 on


def test_success_is_counted_along_each_axis_of_the_starts(tmp_path: Path):
    run = make_run(tmp_path / "a", successes=5)
    rows = [text.split(",") for text in (run / "episodes.csv").read_text().splitlines()]
    for episode, row in enumerate(rows[1:]):  # along x in order, along y and z one place
        row[1:4] = [str(episode), "1", "2"]
    (run / "episodes.csv").write_text("\n".join(",".join(row) for row in rows))
    shown = section(reported(run), "maps")
    (cells,) = shown.tables[0].rows
    shares = [cell.split(" %")[0] for cell in cells[2:]]
    # Fifths of two starts each; those of the first five episodes succeed.
    assert shares == ["100.0", "100.0", "50.0", "0.0", "0.0"]
    assert [chart.title for chart in shown.charts] == ["success over door_position.x"]


def test_the_map_shows_the_share_of_the_seeds_that_succeed(two_seeds: Report):
    (trace,) = drawn(two_seeds, "maps", "dbc_sac: success by start")
    # One of two seeds from five of the starts; failures are drawn on top.
    assert trace["marker"]["color"] == [1.0] * 5 + [0.5] * 5


def test_a_diagnostic_out_of_its_range_is_marked(tmp_path: Path):
    well = curve(0.0, 0.5, q_demo_actions=10.0, q_policy_actions=10.5)
    ill = curve(0.0, 0.5, q_demo_actions=10.0, q_policy_actions=12.0)
    make_run(tmp_path / "well" / "seed0", points=well)
    make_run(tmp_path / "ill" / "seed0", points=ill)
    shown = section(reported(tmp_path), "diagnostics").tables[0]
    (cells,) = (row for row in shown.rows if row[0].startswith("overestimation"))
    assert dict(zip(shown.headers[2:], cells[2:], strict=True)) == {
        "well": "0.05",
        "ill": "0.2 (!)",
    }


def test_a_long_table_is_closed_until_it_is_asked_for():
    table = Table(["row", "share"], [["mine", "1"]], "At other thresholds", folded=True)
    page = Report("title", "summary", [Section("long", "Long", tables=[table])]).html()
    (inside,) = re.findall(
        r"<details><summary>At other thresholds</summary>(.*?)</details>", page, re.DOTALL
    )
    assert "mine" in inside
    assert "<h3>At other thresholds</h3>" not in page


def test_likeness_stands_below_that_of_the_demonstrations(tmp_path: Path):
    for seed, path in ((0, [0.01, 0.02, 0.03]), (1, [0.03, 0.04, 0.05])):
        theirs = {"path_distance": [0.01, 0.015, 0.02], "jerk_mean": None}
        alike = {"to": "demos.h5", "path_distance": path, "of_demonstrations": theirs}
        alike["steps"], theirs["steps"] = [70.0, 80.0 + 20 * seed, 120.0], [150.0, 200.0, 210.0]
        make_run(tmp_path / f"{seed}", seed=seed, further={"likeness": alike})
    shown = section(reported(tmp_path), "likeness").tables[0]
    assert [(row[0], row[1]) for row in shown.rows] == [
        ("demonstrations: demos.h5", "1.5 [1, 2]"),
        ("dbc_sac", "3 [2, 4]"),  # means over the two seeds, cm
    ]
    demonstrations, ours = drawn(reported(tmp_path), "likeness", "speed against likeness")
    assert (demonstrations["x"], demonstrations["y"]) == ([200.0], [1.5])
    assert (ours["name"], ours["x"], ours["y"]) == ("dbc_sac", [90.0], [3.0])
    assert (ours["error_x"]["array"], ours["error_x"]["arrayminus"]) == ([30.0], [20.0])


@pytest.mark.parametrize(
    ("of_the_longest", "told"),
    [(119.5, ["s", "1.0", "119.5"]), (120.0, ["min", "0.0", "2.0"])],
)
def test_wall_time_of_short_runs_is_in_seconds(
    tmp_path: Path, of_the_longest: float, told: list[str]
):
    for name, seconds in (("short", 1.0), ("long", of_the_longest)):
        run = make_run(tmp_path / name / "seed0")
        (run / "time_use.json").write_text(json.dumps({"parts_s": {"updates": seconds}}))
    report = reported(tmp_path)
    all_of = [line(report, "time", name)["all"] for name in ("short", "long")]
    assert [*all_of] == told[1:]
    assert f"of a row, {told[0]}." in section(report, "time").text


@pytest.mark.parametrize(("updates", "told"), [((0, 0), True), ((0, 3), False)])
def test_a_row_whose_actor_got_no_update_is_its_clone(
    tmp_path: Path, updates: tuple[int, int], told: bool
):
    """Of two seeds; a clone's own curve counts its updates otherwise, and is what it says."""
    for seed, count in enumerate(updates):
        points = curve(0.0, 0.5, actor_updates=count)
        make_run(tmp_path / "bc_sac" / f"seed{seed}", seed=seed, points=points)
    offline = curve(0.5, actor_updates=0)
    make_run(tmp_path / "bc" / "seed0", variant="bc", frames=0, points=offline)
    report = reported(tmp_path)
    assert ("missing" in [part.key for part in report.sections]) is told
    if told:
        (said,) = section(report, "missing").absent
        assert said.startswith("bc_sac: actor updates: 0, so this row is the policy")


def test_wall_time_is_in_minutes_by_part(two_seeds: Report):
    assert line(two_seeds, "time", "dbc_sac") == {
        "row": "dbc_sac", "all": "2.0", "updates": "1.5", "setup": "0.5",
    }  # fmt: skip


def test_every_number_says_where_it_is_from(two_seeds: Report, tmp_path: Path):
    found = line(two_seeds, "provenance", f"{tmp_path.name}/b")
    assert found["again with"] == f"make eval RUN={tmp_path.name}/b EPISODES=10"
    assert found["revision of the evaluation"] == "0123456789*"
    assert (found["seed"], found["evaluation seed"]) == ("1", "7")
    assert (found["demonstrations"], found["SHA-256"]) == ("demos.h5", "abcdef0123")


def test_a_command_says_again_what_the_evaluation_was_told(tmp_path: Path):
    """In words of a shell: a task of somebody's own, and settings with quotes and spaces."""
    told = ('task.name="my tasks/lift.py:LIFT"', "evaluation.noise_scale=0.5", "env.horizon=7")
    run = make_run(tmp_path / "my runs", overrides=told)
    found = line(reported(run), "provenance", f"{tmp_path.name}/my runs")["again with"]
    assert shlex.split(found) == [
        "make", "eval", f"RUN={tmp_path.name}/my runs", "EPISODES=10",
        "TASK=my tasks/lift.py:LIFT", "ARGS=evaluation.noise_scale=0.5 env.horizon=7",
    ]  # fmt: skip


def test_a_command_names_a_task_of_ones_own_that_only_the_run_names(tmp_path: Path):
    """As after an evaluation with TRUST=1: its overrides do not name the task."""
    run = make_run(tmp_path / "run", task="my tasks/lift.py:LIFT")
    found = line(reported(run), "provenance", f"{tmp_path.name}/run")["again with"]
    assert "TASK=my tasks/lift.py:LIFT" in shlex.split(found)


def test_a_command_names_files_of_ones_own_that_only_the_run_names(tmp_path: Path):
    task = {"name": "gymnasium:A-v0", "success": "rules.py:won"}
    run = make_run(tmp_path / "run")
    (run / "config.yaml").write_text(f"variant: bc\ntask: {task}\n")
    found = line(reported(run), "provenance", f"{tmp_path.name}/run")["again with"]
    assert "ARGS=task.success=rules.py:won" in shlex.split(found)


def test_the_remedy_for_an_outdated_evaluation_names_a_task_of_ones_own(tmp_path: Path):
    run = make_run(tmp_path / "run", task="my tasks/lift.py:LIFT")
    (run / "checkpoints" / f"checkpoint-{80:012d}").mkdir(parents=True)
    (said,) = section(reported(run), "missing").absent
    assert said.endswith(f"with: make eval RUN={run} TASK='my tasks/lift.py:LIFT'")


def test_a_run_without_an_evaluation_names_a_task_of_ones_own(tmp_path: Path):
    run = make_run(tmp_path / "run", task="lift.py:LIFT")
    (run / "evaluation.json").unlink()
    made = reported(run)
    assert section(made, "missing").absent[0].endswith(f"make eval RUN={run} TASK=lift.py:LIFT")
    found = line(made, "provenance", f"{tmp_path.name}/run")["again with"]
    assert found == f"make eval RUN={run} TASK=lift.py:LIFT"


# ------------------------------------------------------------------------------------ missing files


@pytest.mark.parametrize(("newest", "outdated"), [(40, False), (80, True)])
def test_a_run_that_went_on_since_its_evaluation_is_told(
    tmp_path: Path, newest: int, outdated: bool
):
    run = make_run(tmp_path / "run")
    for frames in (20, newest):
        (run / "checkpoints" / f"checkpoint-{frames:012d}").mkdir(parents=True)
    assert ("missing" in [part.key for part in reported(run).sections]) is outdated
    if outdated:
        (said,) = section(reported(run), "missing").absent
        assert "is of checkpoint-000000000040, and the run has gone on to" in said
        assert f"make eval RUN={run}" in said


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("evaluation.json", None, "evaluation.json does not exist; make it with: make eval RUN="),
        ("evaluation.json", "{", "evaluation.json is not an evaluation"),
        ("episodes.csv", None, "episodes.csv does not exist; make it with: make eval RUN="),
        ("episodes.csv", "episode,return\n0,1\n", "episodes.csv holds 1 episodes and"),
        ("learning_curve.jsonl", None, "learning_curve.jsonl: no learning curve"),
        ("learning_curve.jsonl", '{"frames": 1', "learning_curve.jsonl is damaged"),
        ("config.yaml", "- a", "config.yaml holds no recipe"),
        ("time_use.json", "[]", "time_use.json holds no object"),
    ],
)
def test_what_cannot_be_read_is_said_and_the_rest_reported(
    tmp_path: Path, name: str, content: str | None, says: str
):
    run = make_run(tmp_path / "ill")
    (run / name).unlink()
    if content is not None:
        (run / name).write_text(content)
    write_report([run, make_run(tmp_path / "well", seed=1)], tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert says in text.split("## What is missing")[1].split("## ")[0]
    assert "dbc_sac" in text


def test_a_published_run_reads_like_a_run(tmp_path: Path):
    results = Path("docs/results/rows")
    report = reported(results / "sac", results / "best" / "seed0.json")
    assert line(report, "results", "sac")["seeds"] == "5"
    # Of docs/results/rows/best/seed0.json: 996 of 1,000 episodes.
    assert line(report, "results", "best")["success"] == "99.6 % [99.0, 99.8]"
    assert len(section(report, "curves").charts) == 3
    found = line(report, "provenance", "best/seed0.json")
    assert found["again with"] == "-"  # there is no policy beside it


# ------------------------------------------------------------------------------------ the page


def test_the_page_needs_no_network(two_seeds: Report):
    page = two_seeds.html()
    plotly = re.compile(r"<script>(/\*\*.*?)</script>", re.DOTALL)
    assert len(plotly.findall(page)) == 1
    ours = plotly.sub("", page)
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//|@import|url\(""", ours)


def test_the_page_holds_every_chart_and_table(two_seeds: Report):
    page = two_seeds.html()
    charts = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert len(charts) == sum(len(part.charts) for part in two_seeds.sections)
    assert all(json.loads(chart)["data"] for chart in charts)
    assert "75.0 % / 94.8 %" in page


def test_names_of_runs_are_text_and_no_markup(tmp_path: Path):
    make_run(tmp_path / "<b>&|" / "seed0")
    report = reported(tmp_path / "<b>&|")
    page = report.html()
    assert "<b>&|" not in page
    assert "&lt;b&gt;&amp;|" in page
    assert r"<b>&\|" in report.markdown()


def test_the_command_writes_both_files(tmp_path: Path):
    run = make_run(tmp_path / "a")
    result = CliRunner().invoke(app, ["report", str(run), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "1 run, 1 of them evaluated" in result.output
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["index.html", "report.md"]


def test_a_missing_extra_is_named_before_any_work(tmp_path: Path, monkeypatch):
    for module in [name for name in sys.modules if name.split(".")[0] in {"plotly", "jinja2"}]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(extras, "find_spec", lambda module: None)
    result = CliRunner().invoke(app, ["report", str(tmp_path / "nowhere")])
    assert "make report needs plotly, which comes with the extra 'report'" in str(result.exception)


def told_strategies(grasp: float) -> dict[str, Any]:
    shares = {"grasp": grasp, "flung": 1 - grasp}
    return {
        "shares": shares,
        "words": {"grasp": "led by a grasp", "flung": "let go"},
        "progress_at_last_contact": [1.0, 1.2, 1.4],
        "travel_untouched_mean": grasp / 2,
        "thresholds": {"untouched": 0.25},
        "sensitivity": {"untouched": {"0.1": {"grasp": 0.0, "flung": 1.0}, "0.25": shares}},
    }


def test_strategies_are_means_over_seeds_with_their_thresholds(tmp_path: Path):
    for seed, grasp in ((0, 0.2), (1, 0.6)):
        further = {"strategies": told_strategies(grasp)}
        make_run(tmp_path / f"{seed}", seed=seed, further=further)
    shown = section(reported(tmp_path), "strategies")
    assert "'grasp': led by a grasp" in shown.text
    assert shown.tables[0].rows == [["dbc_sac", "40", "60", "1.2 [1, 1.4]", "20.0"]]
    # What is told at 0.25, the threshold in use, stands above; nothing is told of how it was held.
    assert shown.tables[1].rows == [["dbc_sac", "untouched 0.1", "0", "100"]]
    bars = drawn(reported(tmp_path), "strategies", "strategies")
    assert {trace["name"]: trace["x"] for trace in bars} == {"grasp": [0.4], "flung": [0.6]}


def test_a_success_is_kept_or_lost_at_the_end(tmp_path: Path):
    """Means over the seeds that tell: nothing was ever flung by the first."""
    for seed, (flung, lost) in enumerate(((None, 0.1), (0.2, 0.3))):
        held = {"kept_at_end": {"grasp": 0.9 - seed / 5, "flung": flung}, "lost_at_end": lost}
        further = {"strategies": told_strategies(0.5) | held}
        make_run(tmp_path / "told" / f"seed{seed}", seed=seed, further=further)
    make_run(tmp_path / "older" / "seed0", further={"strategies": told_strategies(0.5)})
    shown = section(reported(tmp_path), "strategies").tables[1]
    assert shown.headers == ["row", "grasp", "flung", "lost, of all"]
    assert shown.rows == [["told", "80", "20", "20"]]


def test_strategies_of_a_task_that_has_neither_thresholds_nor_contacts(tmp_path: Path):
    told = {"shares": {"left": 0.25, "right": 0.75}, "words": {"left": "west", "right": "east"}}
    make_run(tmp_path / "run", further={"strategies": told})
    shown = section(reported(tmp_path), "strategies")
    assert "Thresholds" not in shown.text
    (only,) = shown.tables
    assert (only.headers, only.rows) == (["row", "left", "right"], [["dbc_sac", "25", "75"]])
    assert "contact" not in only.caption


def test_what_a_run_withstands_is_shown_where_it_was_asked(tmp_path: Path):
    run = make_run(tmp_path / "run")
    assert "robustness" not in [s.key for s in reported(run).sections]
    rungs = (Measured("1 step", 0.5, (0.4, 0.6), 3.0), Measured("2 steps", refused="no"))
    whole = Measured("undisturbed", 1.0, (0.9, 1.0), 5.0)
    ladder = Ladder("delay", "delay of actions", rungs)
    made_from = {"run": "run", "evaluation_seed": 1}
    Robustness(0.9, 20, whole, (ladder,), made_from).write(run)
    table = section(reported(run), "robustness").tables[0]
    row = ["delay of actions", "1 step: 50.0 [40.0, 60.0]", "2 steps: refused", "1 step"]
    assert table.rows == [row]
    (cells,) = drawn(reported(run), "robustness", f"{tmp_path.name}/run: success under disturbance")
    assert cells["z"] == [[0.5, None]]
    assert cells["text"] == [["1 step<br>50 %", "2 steps<br>refused"]]
    (run / ROBUSTNESS).write_text("{}")
    assert any(ROBUSTNESS in line for line in section(reported(run), "missing").absent)


def test_some_sections_alone(tmp_path: Path):
    run = make_run(tmp_path / "run")
    written = write_report([run], tmp_path / "out", ["times", "stages"])
    assert [s.key for s in written.sections] == ["stages", "times"]
    assert "Provenance" not in (tmp_path / "out" / "report.md").read_text()
    with pytest.raises(ValueError, match="ONLY=weather is no section of this report; it has"):
        write_report([run], tmp_path / "out", ["weather"])


def test_a_run_with_an_evaluation_that_cannot_be_used_does_not_keep_the_others_out(tmp_path: Path):
    make_run(tmp_path / "good", successes=5)
    broken = make_run(tmp_path / "broken") / "evaluation.json"
    content = json.loads(broken.read_text()) | {"episodes": 0}
    del content["sha256"]
    broken.write_text(json.dumps(content))
    found = reported(tmp_path / "good", tmp_path / "broken")
    assert line(found, "results", "dbc_sac")["seeds"] == "1"
    (told,) = (t for t in section(found, "missing").absent if "evaluation.json" in t)
    assert "its episodes is 0" in told


def test_stages_are_of_the_runs_that_tell_them(tmp_path: Path):
    """Where the table of episodes is missing, and one evaluation is from before there were any."""
    for seed, further in enumerate(({}, {"stages": {}})):
        run = make_run(tmp_path / str(seed), seed=seed, successes=5, further=further)
        (run / "episodes.csv").unlink()
    assert line(reported(*tmp_path.iterdir()), "stages", "dbc_sac")["there"] == "50.0 %"


def test_a_text_is_no_figure(tmp_path: Path):
    """Of a task's own: those of every task are looked at when the evaluation is read."""
    make_run(tmp_path / "a", further={"angle_mean_deg": "much"})
    assert section(reported(tmp_path / "a"), "results").tables
