"""Tables I and II: the paper's numbers as printed, ours beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from envs.door.paper import PAPER, TABLE_1, TABLE_2
from pipeline.files.run_files import RunDirectoryError
from pipeline.results.evaluation import Evaluation
from pipeline.results.run_tables import reference_of, reference_row, render
from tests.pipeline.results.evaluated import evaluation_of

# As the paper prints them: return, angle, angle without failures; shares in per cent.
TABLE_I = """
SAC                    4.1    2.2  12.3
BC                   461.0   41.1  55.9
BC-SAC (lambda = 0.1) 65.3    7.9  51.1
BC-SAC (lambda = 1)  955.8   83.1  84.0
BC-SAC (lambda = 10) 868.8   77.7  81.3
DBC-SAC              966.7   86.4  86.5
SID-BC-SAC           910.7   82.0  82.7
SID-DBC-SAC          966.8   86.7  86.7
ILD-BC-SAC           704.5   62.1  62.3
ILD-DBC-SAC          614.0   54.3  56.2
DA-SAC                46.0    5.2  11.0
"""


def evaluation(variant: str = "dbc_sac", steps: int | None = None, **changes) -> Evaluation:
    columns = dict.fromkeys([c.key for table in PAPER.tables.values() for c in table], 0.5)
    made_from = {"variant": variant, "seed": 3, "bc_weight": 1.0, "task": "door", "frames": 1000}
    made_from |= {} if steps is None else {"simulator_steps": steps}
    return evaluation_of(made_from, **({"episodes": 1000} | columns | changes))


def cells(text: str, variant: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith(f"| {variant}")
    ]


TABLE_II = """
SAC                   18.2  4.9  1    0.2
BC                    73.6 64.8 34.9 27.6
BC-SAC (lambda = 0.1) 15.5 11.8 10.1  0
BC-SAC (lambda = 1)   98.9 97.5 92.5 83.9
BC-SAC (lambda = 10)  95.6 93.8 88.1 78
DBC-SAC               99.9 99.3 98.2 94.8
SID-BC-SAC            99.1 99   98.2 93.5
SID-DBC-SAC          100  100   99.9 97.1
ILD-BC-SAC            96.6 95.1 42.5 36.1
ILD-DBC-SAC           99.7 96.2 55.5 42
DA-SAC                47.9 11.7  0.8  0
"""


# The rows of both tables in the order in which the paper prints them.
NAMES = (
    "sac", "bc", "bc_sac_0.1", "bc_sac_1", "bc_sac_10", "dbc_sac", "sid_bc", "sid_dbc", "ila_bc",
    "ila_dbc", "da_sac",
)  # fmt: skip


def printed(table: str, columns: int) -> list[list[float]]:
    rows = [line.rsplit(maxsplit=columns)[1:] for line in table.strip().splitlines()]
    return [[float(value) for value in values] for values in rows]


def test_the_papers_first_table():
    ours = [[PAPER.rows[name][column.key] for column in TABLE_1] for name in NAMES]
    assert ours == printed(TABLE_I, 3)
    assert set(PAPER.rows) == set(NAMES)


def test_the_papers_second_table():
    ours = [
        [pytest.approx(100 * PAPER.rows[name][column.key]) for column in TABLE_2] for name in NAMES
    ]
    assert printed(TABLE_II, 4) == ours


def test_ours_stand_beside_the_papers():
    changes = {"return_mean": 800.04, "return_std": 100.0, "share_gt_1_35": 0.9}
    first, second, *_ = cells(render([evaluation(**changes, episodes=100)], PAPER), "dbc_sac")
    # 800.04 +- 1.96 * 100 / sqrt(100).
    returns = "800.0 [780.4, 819.6] / 966.7"
    assert first == ["dbc_sac", "3", "100", "1,000", "-", returns, "0.5 / 86.4", "0.5 / 86.5"]
    # Wilson, z2 = 3.8415: (p + z2/200 +- z sqrt(p (1 - p)/100 + z2/40000)) / (1 + z2/100).
    assert second[5:9] == [
        "50.0 % [40.4, 59.6] / 99.9 %",
        "50.0 % [40.4, 59.6] / 99.3 %",
        "50.0 % [40.4, 59.6] / 98.2 %",
        "90.0 % [82.6, 94.5] / 94.8 %",
    ]


def test_frames_and_all_simulator_steps_stand_beside_each_other():
    text = render([evaluation(steps=268_770), evaluation("bc")], PAPER)
    head = next(line for line in text.splitlines() if line.startswith("| variant"))
    assert [cell.strip() for cell in head.split("|")[4:6]] == ["frames", "simulator steps"]
    assert [found[3:5] for found in cells(text, "dbc_sac")] == [["1,000", "268,770"]] * 2
    # Of before they were counted: not 0.
    assert [found[3:5] for found in cells(text, "bc")] == [["1,000", "-"]] * 2


def test_a_door_that_never_opened_has_no_angle():
    first, *_ = cells(render([evaluation(angle_mean_deg_opened=None)], PAPER), "dbc_sac")
    assert first[-1] == "- / 86.5"


def test_a_variant_of_ones_own_has_no_paper_row():
    first, second, *_ = cells(render([evaluation("mine")], PAPER), "mine")
    assert first[5:] == ["0.5 / -"] * 3
    assert second[5:] == ["50.0 % [46.9, 53.1] / -"] * 6


@pytest.mark.parametrize(
    ("weight", "expected"),
    [(0.1, 65.3), (1.0, 955.8), (10.0, 868.8), (10, 868.8), (3.0, None), (None, None)],
)
def test_bc_sac_has_a_row_per_lambda(weight: float | None, expected: float | None):
    row = reference_row(PAPER, "bc_sac", weight)
    assert (row["return_mean"] if row is not None else None) == expected


@pytest.mark.parametrize(
    "variant", sorted({name for name in PAPER.rows if not name.startswith("bc_sac_")})
)
def test_other_variants_have_their_row_whatever_lambda(variant: str):
    assert reference_row(PAPER, variant, 123.0) is PAPER.rows[variant]


def test_an_evaluation_of_another_task_is_refused():
    pendulum = evaluation_of({}, return_mean=-900.0)
    with pytest.raises(ValueError, match="runs/x: its evaluation has no 'angle_mean_deg'"):
        render([pendulum], PAPER)


@pytest.mark.parametrize("value", ["much", [1.0], True], ids=["text", "list", "truth"])
def test_a_figure_of_the_task_that_is_no_number_is_named(value: object):
    with pytest.raises(ValueError, match=r"runs/x: its evaluation's angle_mean_deg is .*a number"):
        render([evaluation(angle_mean_deg=value)], PAPER)


def test_a_table_is_of_one_task_that_has_published_rows():
    assert reference_of([evaluation(), evaluation("bc")]) is PAPER
    older = evaluation_of({"env": "door"})  # of when tasks were called environments
    assert reference_of([older]) is PAPER
    pendulum = evaluation_of({"task": "gymnasium:Pendulum-v1"})
    with pytest.raises(ValueError, match=r"of one task, and these runs are of .*Pendulum"):
        reference_of([evaluation(), pendulum])
    with pytest.raises(
        ValueError, match=r"task gymnasium:Pendulum-v1 has none .* make report RUNS="
    ):
        reference_of([pendulum])


@pytest.mark.parametrize("form", ["{folder}/theirs.py:Theirs", "gymnasium:theirs:Theirs-v0"])
def test_a_table_runs_nothing_that_only_an_evaluation_names(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "theirs.py").write_text("raise ZeroDivisionError('it ran')")
    monkeypatch.syspath_prepend(tmp_path)
    named = evaluation_of({"task": form.format(folder=tmp_path)})
    with pytest.raises(RunDirectoryError, match=r"running its code. If you trust it, set TRUST=1"):
        reference_of([named])
    monkeypatch.setenv("TRUST", "1")
    with pytest.raises(Exception, match="it ran"):
        reference_of([named])
