"""Published results: statistics by hand, and a set of tiny runs from end to end."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rliable import library, metrics
from tensordict import TensorDict
from typer.testing import CliRunner

from configs import compose
from envs.door.definition import TASK
from envs.door.paper import PAPER
from envs.reference import Column
from pipeline.build import build_run
from pipeline.cli import app
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.run_files import EVALUATION, RunDirectoryError
from pipeline.policy import WEIGHTS, load_policy
from pipeline.results import statistics
from pipeline.results.curves import on_grid
from pipeline.results.estimates import estimate
from pipeline.results.evaluation import Evaluation
from pipeline.results.export import card_of, export_policy, exported_seed
from pipeline.results.publish import publish
from pipeline.results.rows import load_published, load_rows, merge_rows
from pipeline.results.runs import EvaluatedRun, RunGroup
from pipeline.results.statistics import interquartile_means, over_tasks
from pipeline.results.tables import render_summary
from pipeline.run_dir import load_recipe, saved_recipe
from tests.pipeline.results.evaluated import evaluation_of
from tests.pipeline.toys import tiny_config

# ------------------------------------------------------------------------------------ statistics


def test_the_interquartile_mean_leaves_out_the_best_and_the_worst_of_five():
    found = interquartile_means(
        {"a": [[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [3.0, 5.0], [99.0, 5.0]]}
    )
    assert found["a"].iqm.tolist() == [2.0, 5.0]
    assert 0.0 <= found["a"].low[0] < 2.0 < found["a"].high[0] <= 99.0
    assert found["a"].low[1] == found["a"].high[1] == 5.0


def test_intervals_are_those_of_rliable_s_own_function():
    """Ours takes its draws, all at once: the numbers are the same to the last digit."""
    scores = np.random.default_rng(1).normal(size=(7, 1))
    state = np.random.get_state()
    np.random.seed(statistics.SEED)
    try:
        points, intervals = library.get_interval_estimates(
            {"a": scores},
            lambda runs: np.array([metrics.aggregate_iqm(runs)]),
            reps=statistics.REPETITIONS,
        )
    finally:
        np.random.set_state(state)
    found = interquartile_means({"a": scores})["a"]
    assert found.iqm == pytest.approx(points["a"])
    low, high = intervals["a"]
    assert (found.low, found.high) == (pytest.approx(low), pytest.approx(high))


def test_every_point_of_a_long_curve_has_its_interval():
    """More points than are held together, each at the interval of the first."""
    scores = np.array([[1.0], [2.0], [4.0], [9.0]])
    one, many = (interquartile_means({"a": s})["a"] for s in (scores, np.tile(scores, 150)))
    assert many.low.tolist() == one.low.tolist() * 150
    assert many.high.tolist() == one.high.tolist() * 150
    assert one.low < one.iqm < one.high


@pytest.mark.parametrize(
    ("values", "told"),
    [
        # One: Wilson's over its episodes, 90 of 100 (see test_run_tables.py).
        ([0.9], "90.0 % [82.6, 94.5]"),
        ([0.2, 0.4], "30.0 %"),
        ([0.4, 0.4, 0.4], "40.0 % [40.0, 40.0]"),
    ],
)
def test_from_three_seeds_on_an_interval_is_of_the_seeds(values: list[float], told: str):
    runs = (
        EvaluatedRun(Path("run"), evaluation_of({"seed": n}, success_once=value))
        for n, value in enumerate(values)
    )
    column = Column("success_once", "success", percent=True)
    found = estimate(RunGroup("row", tuple(runs)), column)
    assert found is not None
    assert found.text(column) == told


def test_over_tasks_the_middle_half_of_all_runs_counts():
    """Of 0, 0.1, ..., 0.7 two are cut off at either end: (0.2 + 0.3 + 0.4 + 0.5) / 4."""
    found = over_tasks({"a": [[0.0, 0.7, 0.2, 0.5], [0.1, 0.6, 0.3, 0.4]]})["a"]
    assert found.iqm.tolist() == pytest.approx([0.35])
    assert 0.0 <= found.low[0] <= 0.35 <= found.high[0] <= 0.7
    with pytest.raises(ValueError, match=r"a: expected finite values .seeds, tasks."):
        over_tasks({"a": [1.0]})


def test_intervals_are_the_same_every_time():
    curves = {"a": np.random.default_rng(0).normal(size=(5, 3))}
    first, second = (interquartile_means(curves)["a"] for _ in range(2))
    assert np.array_equal(first.low, second.low)
    assert np.array_equal(first.high, second.high)


def test_values_that_are_not_numbers_are_refused():
    with pytest.raises(ValueError, match="a: expected finite values"):
        interquartile_means({"a": [[float("nan")]]})


def test_a_curve_holds_its_last_value_until_the_next():
    grid = [0.0, 9.9, 10.0, 15.0, 99.0]
    assert on_grid([5, 10, 20], [1, 2, 3], grid).tolist() == [1, 1, 2, 2, 3]


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=20))
def test_a_curve_read_where_it_was_measured_is_itself(y: list[float]):
    x = list(range(len(y)))
    assert on_grid(x, y, x).tolist() == y


# ------------------------------------------------------------------------------------ end to end


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    """Evaluated runs of one row with two seeds and one with one, and a run that is under way."""
    folder = tmp_path_factory.mktemp("rows")
    for row, variant, seeds in (("best_of_two", "dbc_sac", (0, 1)), ("bc", "bc", (0,))):
        for seed in seeds:
            run_dir = folder / row / f"seed{seed}"
            config = tiny_config(variant, folder, demos, f"seed={seed}", "torch_threads=1")
            build_run(config, run_dir).train()
            evaluation = evaluate_run(run_dir, episodes=2)
            (run_dir / EVALUATION).write_text(json.dumps(evaluation))
    (folder / "bc" / "seed1").mkdir()
    return folder


@pytest.fixture(scope="module")
def published(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    publish(runs, out, unclean=True)
    return out


def test_runs_that_are_not_evaluated_are_left_out(runs: Path):
    assert {row.name: [run.seed for run in row.runs] for row in load_rows(runs)} == {
        "bc": [0],
        "best_of_two": [0, 1],
    }


def test_a_folder_without_runs_names_the_command(tmp_path: Path):
    with pytest.raises(RunDirectoryError, match="make rows"):
        load_rows(tmp_path)


def test_the_table_holds_every_seed_s_evaluation(runs: Path, published: Path):
    table = json.loads((published / "table.json").read_text())
    assert list(table) == ["bc", "best_of_two"]
    row = table["best_of_two"]
    assert (row["frames"], row["preset"]) == (40, "smoke")
    assert [seed["seed"] for seed in row["seeds"]] == [0, 1]
    evaluation = json.loads((runs / "best_of_two" / "seed1" / EVALUATION).read_text())
    assert row["seeds"][1]["return_mean"] == evaluation["return_mean"]
    assert table["bc"]["frames"] == 0


def test_published_files_name_no_place_on_this_machine(runs: Path, published: Path):
    for path in published.rglob("*"):
        if path.suffix in {".json", ".md", ".yaml"}:
            text = path.read_text()
            assert str(runs) not in text, path
            assert str(runs.parent) not in text, path


def test_curves_keep_a_row_for_each_evaluation(published: Path):
    seed = json.loads((published / "rows" / "best_of_two" / "seed0.json").read_text())
    assert seed["curve"]["frames"][-1] == 40
    assert {len(column) for column in seed["curve"].values()} == {len(seed["curve"]["frames"])}


def test_figures_are_drawn(published: Path):
    names = ("curves_frames", "curves_simulator_steps", "curves_wall_s")
    for name in (*(f"{n}.png" for n in names), "rows/best_of_two/diagnostics.png"):
        assert (published / name).stat().st_size > 5000


def test_the_tables_have_a_line_for_each_row(published: Path):
    text = (published / "tables.md").read_text()
    assert text.count("| best_of_two |") == 2
    (bc,) = (line for line in text.splitlines() if line.startswith("| bc ") and "27.6" in line)
    # Wilson's interval of 0 of 2 episodes: 1.96^2 / (2 + 1.96^2) = 65.8 %.
    assert "| 0.0 % [0.0, 65.8] / 27.6 %" in bc
    (two,) = (line for line in text.split("Table II")[1].splitlines() if "best_of_two" in line)
    # The paper does not say how many doors are open at the end, or for how long.
    # Of two seeds there is no interval.
    assert [cell.strip() for cell in two.split("|")[-4:-1]] == [
        "0.0 % / 94.8 %", "0.0 % / -", "0.0 % / -",
    ]  # fmt: skip


def test_the_summary_is_the_mean_over_seeds_beside_the_paper_s_number():
    shares = dict.fromkeys(("share_gt_0", "share_gt_0_2", "share_gt_1_0"), 1.0)
    rows = [
        RunGroup(
            name,
            tuple(
                EvaluatedRun(
                    Path("run"),
                    evaluation_of(
                        {"seed": seed, "variant": variant, "frames": 1000 + seed, **steps},
                        return_mean=value,
                        share_gt_1_35=share,
                        success_at_end=share / 2,
                        **shares,
                    ),
                )
                for seed, (value, share) in enumerate(((1.0, 1.0), (2.0, 0.97), (9.0, 0.4)))
            ),
        )
        for name, variant, steps in (
            ("dbc_sac", "dbc_sac", {"simulator_steps": 25_000}),
            ("ours", "best", {}),
        )
    ]
    theirs, ours = (line.split("|")[1:-1] for line in render_summary(rows, PAPER).splitlines()[2:])
    assert [cell.strip() for cell in theirs[:5]] == [
        "`dbc_sac`", "3", "1,001", "25,000", "4.0 / 966.7",
    ]  # fmt: skip
    # None of DAPG's in these evaluations, as in those of before.
    assert [cell.strip() for cell in theirs[-3:]] == ["79.0 % / 94.8 %", "39.5 %", "-"]
    # Nobody counted the steps of ours, which is not 0.
    assert [ours[n].strip() for n in (3, 4, -3)] == ["-", "4.0", "79.0 %"]


def test_a_published_policy_acts_like_its_run(runs: Path, published: Path):
    folder = published / "policies" / "bc"
    ours, origin = load_policy(load_recipe(folder), TASK, folder)
    theirs, _ = load_policy(load_recipe(runs / "bc" / "seed0"), TASK, runs / "bc" / "seed0")
    observation = TensorDict({"observation": torch.randn(5, 38)}, [5])
    with torch.no_grad():
        assert torch.equal(ours.get_dist(observation).loc, theirs.get_dist(observation).loc)
    assert origin.name == WEIGHTS
    assert evaluate_run(folder, episodes=2)["return_mean"] == pytest.approx(
        evaluate_run(runs / "bc" / "seed0", episodes=2)["return_mean"]
    )


@pytest.mark.parametrize(
    ("action", "said"),
    [
        ({"exploration": "mean", "noise_scale": 0.5}, "mean action."),
        ({"exploration": "sample", "noise_scale": 0.5}, "sampled action, its noise times 0.5."),
        ({"exploration": "sample"}, "sampled action, its noise times 1."),  # before it was named
    ],
)
def test_the_card_of_a_policy_says_how_it_acted(
    action: dict, said: str, runs: Path, tmp_path: Path
):
    (row,) = (row for row in load_rows(runs) if row.name == "bc")
    evaluation = row.runs[0].evaluation.content
    made_from = {k: v for k, v in evaluation["made_from"].items() if k != "noise_scale"}
    changed = Evaluation.of({**evaluation, "made_from": {**made_from, **action}})
    export_policy(EvaluatedRun(runs / "bc" / "seed0", changed), tmp_path / "bc", name="bc")
    assert said in (tmp_path / "bc" / "README.md").read_text()


def test_published_weights_of_another_size_are_refused(published: Path):
    folder = published / "policies" / "best_of_two"
    config = load_recipe(folder, ["actor.hidden=[16]"])
    with pytest.raises(ValueError, match=r"policy\.safetensors is damaged or does not fit"):
        load_policy(config, TASK, folder)


def test_the_seed_in_the_middle_by_success_and_then_return_comes_first():
    successes = (0.9, 0.7, 1.0, 0.8, 0.95)
    best_last = [seed_with(n, 100 - n, once=once) for n, once in enumerate(successes)]
    assert RunGroup("five", tuple(best_last)).by_distance_to_median[0].seed == 0
    row = RunGroup("five", tuple(seed_with(n, r) for n, r in enumerate((50, 10, 40, 20, 30))))
    assert row.by_distance_to_median[0].evaluation.return_mean == 30
    nearest = {run.evaluation.return_mean for run in row.by_distance_to_median[:3]}
    assert nearest == {20, 30, 40}


# ---------------------------------------------------------------------- seeds of several sessions


def seed_with(number: int, value: float, once: float = 1.0, **made_from: object) -> EvaluatedRun:
    origin = {"seed": number, "run": f"seed{number}", "demos": "d.h5", **made_from}
    return EvaluatedRun(Path("run"), evaluation_of(origin, return_mean=value, success_once=once))


@pytest.fixture
def in_two_goes(runs: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The runs of one row in two folders, as two machines would have them."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder, seed in ((first, "seed0"), (second, "seed1")):
        shutil.copytree(runs / "best_of_two" / seed, folder / "two" / seed)
    return first, second


def test_publishing_in_two_goes_is_publishing_at_once(
    runs: Path, in_two_goes: tuple[Path, Path], tmp_path: Path
):
    both, out = tmp_path / "both", tmp_path / "out"
    shutil.copytree(runs / "best_of_two", both / "two")
    publish(both, tmp_path / "at_once", policies=False, unclean=True)
    for folder in in_two_goes:
        publish(folder, out, unclean=True)
        shutil.rmtree(folder)  # as a machine that is given back
    for name in (
        "table.json",
        "tables.md",
        "summary.md",
        "rows/two/seed0.json",
        "rows/two/seed1.json",
    ):
        assert (out / name).read_text() == (tmp_path / "at_once" / name).read_text(), name


def test_a_seed_that_is_run_again_replaces_its_published_one(
    in_two_goes: tuple[Path, Path], tmp_path: Path
):
    first, _ = in_two_goes
    publish(first, tmp_path / "out", policies=False, unclean=True)
    path = first / "two" / "seed0" / EVALUATION
    path.write_text(json.dumps({**json.loads(path.read_text()), "return_mean": 123.0}))
    (row,) = publish(first, tmp_path / "out", policies=False, unclean=True)
    assert row.figures("return_mean") == [123.0]


def test_the_published_policy_nearest_to_the_median_stays(
    in_two_goes: tuple[Path, Path], tmp_path: Path
):
    first, second = in_two_goes
    for folder, value in ((first, 10.0), (second, 0.0)):
        (path,) = folder.glob(f"two/*/{EVALUATION}")
        path.write_text(json.dumps({**json.loads(path.read_text()), "return_mean": value}))
    publish(first, tmp_path / "out", unclean=True)
    shutil.rmtree(first)
    publish(second, tmp_path / "out", unclean=True)  # of 0 and 10, the upper one is the middle
    assert exported_seed(tmp_path / "out" / "policies" / "two") == 0
    path.write_text(json.dumps({**json.loads(path.read_text()), "return_mean": 20.0}))
    publish(second, tmp_path / "out", unclean=True)
    assert exported_seed(tmp_path / "out" / "policies" / "two") == 1


def test_a_cell_s_policy_is_of_its_middle_seed_and_judged_as_its_run(runs: Path, tmp_path: Path):
    """Of two seeds the upper one; two folders, so that it is not the table of one task."""
    first, second = runs / "best_of_two" / "seed0", runs / "best_of_two" / "seed1"
    values = {}
    for name, value in (("a", 10.0), ("b", 0.0)):
        shutil.copytree({"a": first, "b": second}[name], tmp_path / name / "two" / "seed0")
        path = tmp_path / name / "two" / "seed0" / EVALUATION
        values[name] = json.loads(path.read_text())
        path.write_text(json.dumps({**values[name], "return_mean": value}))
    out = tmp_path / "out"
    folders = [str(tmp_path / name) for name in ("a", "b")]
    done = CliRunner().invoke(app, ["results", *folders, "--out", str(out), "--unclean"])
    assert done.exit_code == 0, done.output
    (folder,) = (path.parent for path in (out / "policies").glob(f"*/*/{WEIGHTS}"))
    row = "dbc_sac_5_demonstrations_not_multiplied"  # and no comma or space, which make splits at
    assert folder.relative_to(out / "policies").parts == ("door_dense", row)
    assert exported_seed(folder) == values["a"]["made_from"]["seed"]
    assert evaluate_run(folder, episodes=2)["return_mean"] == pytest.approx(
        evaluate_run(first, episodes=2)["return_mean"]
    )
    card = (folder / "README.md").read_text()
    assert f"make eval RUN=docs/results/policies/door_dense/{row}`" in card


@pytest.mark.parametrize("folders", [1, 2])  # a task's own tables, and cells over tasks
def test_nothing_is_published_of_runs_whose_weights_are_gone(
    runs: Path, tmp_path: Path, folders: int
):
    """Not the rows or cells before the policies, and no policy of a row before the missing one."""
    given, out = [], tmp_path / "out"
    for number in range(folders):
        shutil.copytree(runs / "best_of_two", tmp_path / f"{number}" / "one")
        shutil.copytree(runs / "best_of_two", tmp_path / f"{number}" / "two")
        given.append(str(tmp_path / f"{number}"))
    for row in ("one", "two"):  # of the second folder the runs are told apart by their seeds alone
        for damaged in (tmp_path / "0" / row).glob("*/checkpoints"):
            shutil.rmtree(damaged)
        done = CliRunner().invoke(app, ["results", *given, "--out", str(out), "--unclean"])
        assert isinstance(done.exception, FileNotFoundError | ValueError), done.output
        assert [path for path in out.rglob("*") if path.is_file()] == []


def test_a_row_of_two_recipes_is_refused():
    earlier = RunGroup("row", (seed_with(0, 1.0, preset="table"),))
    later = RunGroup("row", (seed_with(1, 1.0, preset="paper"),))
    with pytest.raises(RunDirectoryError, match="row row: seed 0 has preset 'table', seed 1 has"):
        merge_rows([earlier], [later])


def test_an_evaluation_from_before_the_noise_was_named_had_all_of_it():
    earlier = RunGroup("row", (seed_with(0, 1.0),))
    merge_rows([earlier], [RunGroup("row", (seed_with(1, 1.0, noise_scale=1.0),))])
    quieter = RunGroup("row", (seed_with(1, 1.0, noise_scale=0.5),))
    with pytest.raises(RunDirectoryError, match=r"seed 0 has noise_scale 1\.0, seed 1 has 0\.5"):
        merge_rows([earlier], [quieter])


def test_rows_that_gain_nothing_are_not_judged(in_two_goes: tuple[Path, Path], tmp_path: Path):
    earlier = RunGroup("old", (seed_with(0, 1.0, preset="a"), seed_with(1, 1.0, preset="b")))
    (old, _) = merge_rows([earlier], load_rows(in_two_goes[0]))
    assert old == earlier


def test_a_damaged_published_file_is_named(in_two_goes: tuple[Path, Path], tmp_path: Path):
    publish(in_two_goes[0], tmp_path / "out", policies=False, unclean=True)
    path = tmp_path / "out" / "rows" / "two" / "seed0.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "curve": {"a": [1], "b": []}}))
    with pytest.raises(RunDirectoryError, match=r"seed0\.json is not a published run"):
        load_published(tmp_path / "out")


# ---------------------------------------------------------------------------------- command line


def test_results_can_leave_the_policies_out(runs: Path, tmp_path: Path):
    typed = ["results", str(runs), "--out", str(tmp_path), "--no-policies", "--unclean"]
    done = CliRunner().invoke(app, typed)
    assert done.exit_code == 0, done.output
    assert "best_of_two: 2 seeds" in done.output
    assert (tmp_path / "table.json").is_file()
    assert not (tmp_path / "policies").exists()


def test_a_run_s_diagnostics_are_plotted(runs: Path, tmp_path: Path):
    out = tmp_path / "figure.png"
    done = CliRunner().invoke(app, ["plot", str(runs / "bc" / "seed0"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert out.stat().st_size > 5000


def test_published_rows_and_seeds_are_plotted_like_runs(published: Path, tmp_path: Path):
    row = published / "rows" / "best_of_two"
    for what in (row, row / "seed0.json"):
        out = tmp_path / f"{what.name}.png"
        done = CliRunner().invoke(app, ["plot", str(what), "--out", str(out)])
        assert done.exit_code == 0, done.output
        assert out.stat().st_size > 5000


def test_a_run_without_a_curve_cannot_be_plotted(runs: Path, tmp_path: Path):
    (tmp_path / "config.yaml").write_text("variant: bc")
    with pytest.raises(RunDirectoryError, match=r"no learning curve; train with"):
        CliRunner().invoke(app, ["plot", str(tmp_path)], catch_exceptions=False)
    with pytest.raises(RunDirectoryError, match=r"is no run: name run directories"):
        CliRunner().invoke(app, ["plot", str(tmp_path / "no")], catch_exceptions=False)


def test_runs_of_changes_that_no_revision_holds_are_no_rows_unless_it_is_said(
    runs: Path, tmp_path: Path
):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    versions = folder / "bc" / "seed0" / "versions.json"
    versions.write_text(json.dumps({"git": None, "packages": {}}))
    with pytest.raises(RunDirectoryError, match=r"was trained outside any revision.*--unclean"):
        publish(folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_card_of_a_policy_says_what_it_was_made_of(published: Path, runs: Path):
    cards = {name: published / "policies" / name / "README.md" for name in ("bc", "best_of_two")}
    updates = saved_recipe(runs / "bc" / "seed0").bc.updates
    assert f"| updates | {updates} |" in cards["bc"].read_text()
    assert "| frames | " not in cards["bc"].read_text()
    assert "| frames | " in cards["best_of_two"].read_text()
    recipe = compose("variant=sac", "task.name=door")
    assert "| demonstrations | none |" in card_of(seed_with(0, 1.0).evaluation, recipe, "sac", 10)
