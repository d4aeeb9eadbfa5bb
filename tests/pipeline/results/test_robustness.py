"""The numbers of ``make robust``: which setting breaks a policy, and what comes back of a file."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.results.robustness import ROBUSTNESS, TABLE, Ladder, Measured, Robustness
from pipeline.results.robustness_figure import plot_robustness

DELAYS = Ladder(
    "delay",
    "delay of actions",
    (
        Measured("1 step", 1.0, (0.9, 1.0), 2000.0),
        Measured("2 steps", 0.8, (0.7, 0.9), 1500.0),
        Measured("3 steps", 0.85, (0.7, 0.9), 1400.0),
    ),
)
HEIGHT = Ladder("door_z", "door_z below its box", (Measured("-0.01 m", refused="it jams"),))
MADE_FROM = {"run": "runs/mine", "evaluation_seed": 5}


def found(bar: float = 0.9) -> Robustness:
    whole = Measured("undisturbed", 1.0, (0.93, 1.0), 2100.0)
    return Robustness(bar, 50, whole, (DELAYS, HEIGHT), MADE_FROM, kinds=("delay",))


def test_the_first_setting_below_the_bar():
    assert DELAYS.first_below(0.9) == "2 steps"
    assert DELAYS.first_below(0.8) is None  # it is at the bar, not below
    assert DELAYS.first_below(0.82) == "2 steps"
    assert HEIGHT.first_below(0.9) is None


def test_what_is_written_comes_back(tmp_path: Path):
    found().write(tmp_path / "new")
    assert Robustness.read(tmp_path / "new" / ROBUSTNESS) == found()
    told = json.loads((tmp_path / "new" / ROBUSTNESS).read_text())
    assert [ladder["first_below"] for ladder in told["ladders"]] == ["2 steps", None]


def test_the_table_has_a_line_a_ladder_with_intervals(tmp_path: Path):
    found().write(tmp_path)
    lines = (tmp_path / TABLE).read_text().splitlines()
    delay = next(line for line in lines if line.startswith("| delay"))
    cells = [cell.strip() for cell in delay.strip("|").split("|")]
    assert cells[1:] == [
        "1 step: 100.0 [90.0, 100.0]",
        "2 steps: 80.0 [70.0, 90.0]",
        "3 steps: 85.0 [70.0, 90.0]",
        "2 steps",
    ]
    height = next(line for line in lines if line.startswith("| door_z"))
    assert "refused" in height
    assert "none was played" in height
    withstood = replace(found(), ladders=(Ladder("delay", "delay", DELAYS.settings[:1]),))
    assert withstood.rows()[0][-1] == "none of these"
    assert "- refused: it jams" in lines


def again(**made_from: object) -> list[str]:
    """Words of the command that the table ends its head with."""
    told = replace(found(), kinds=("delay", "mass"), made_from=MADE_FROM | made_from).markdown()
    line = next(line for line in told.splitlines() if line.startswith("Again: "))
    return shlex.split(line.removeprefix("Again: `").removesuffix("`."))


def test_the_command_again_has_what_it_was_asked():
    assert again(task="door") == [
        "make", "robust", "RUN=runs/mine", "EPISODES=50", "BAR=0.9", "ONLY=delay,mass",
    ]  # fmt: skip


def test_the_command_again_names_a_task_of_ones_own_and_further_settings():
    assert again(
        run="my runs/a",
        task="my tasks/lift.py:LIFT",
        overrides=['task.name="my tasks/lift.py:LIFT"', "env.horizon=7"],
    )[2:] == [
        "RUN=my runs/a", "EPISODES=50", "BAR=0.9", "ONLY=delay,mass",
        "TASK=my tasks/lift.py:LIFT", "ARGS=env.horizon=7",
    ]  # fmt: skip


def test_what_breaks_a_policy_is_not_told_where_it_fails_undisturbed(tmp_path: Path):
    weak = replace(found(), undisturbed=Measured("undisturbed", 0.7, (0.6, 0.8), 900.0))
    assert [row[-1] for row in weak.rows()] == ["undisturbed already"] * 2
    assert "undisturbed policy is itself below the bar of 90 %" in weak.markdown()
    assert "itself below" not in found().markdown()
    weak.write(tmp_path)
    told = json.loads((tmp_path / ROBUSTNESS).read_text())
    assert [ladder["first_below"] for ladder in told["ladders"]] == ["undisturbed", "undisturbed"]


def test_a_file_of_before_it_kept_the_kinds_is_read(tmp_path: Path):
    found().write(tmp_path)
    told = json.loads((tmp_path / ROBUSTNESS).read_text())
    del told["kinds"]
    (tmp_path / ROBUSTNESS).write_text(json.dumps(told))
    assert Robustness.read(tmp_path / ROBUSTNESS).kinds == ()


def test_a_figure_is_drawn(tmp_path: Path):
    plot_robustness(found(), tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"bar": "high"}, "its bar is 'high': .* valid number"),
        ({"episodes": 2.5}, r"its episodes is 2\.5: .* valid integer"),
        ({"undisturbed": {"setting": "none", "success": 7}}, r"its undisturbed\.success is 7"),
        ({"ladders": [{"kind": "delay", "what": "x"}]}, r"it has no ladders\.0\.settings"),
    ],
)
def test_a_value_that_no_reader_could_use_is_named_with_its_key(
    tmp_path: Path, wrong: dict[str, object], told: str
):
    found().write(tmp_path)
    path = tmp_path / ROBUSTNESS
    path.write_text(json.dumps(json.loads(path.read_text()) | wrong))
    with pytest.raises(RunDirectoryError, match=rf"{ROBUSTNESS} is damaged \({told}") as refused:
        Robustness.read(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"bar": 1, "ladders": 3}'])
def test_a_damaged_file_is_named(tmp_path: Path, text: str):
    (tmp_path / ROBUSTNESS).write_text(text)
    with pytest.raises(RunDirectoryError, match=rf"{ROBUSTNESS} is damaged.*make robust RUN="):
        Robustness.read(tmp_path / ROBUSTNESS)
    with pytest.raises(RunDirectoryError, match="cannot be read"):
        Robustness.read(tmp_path / "elsewhere" / ROBUSTNESS)
