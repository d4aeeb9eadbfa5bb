"""A run and a group of runs: figures that all tell, and curves at places of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.results.curves import Floats, curve_of, last_of
from pipeline.results.reading import load_run
from pipeline.results.runs import EvaluatedRun, RunGroup
from tests.pipeline.results.evaluated import evaluated, evaluation_of


def group(*curves: list[dict[str, Any]]) -> RunGroup:
    return RunGroup("row", tuple(EvaluatedRun(Path("run"), curve=curve) for curve in curves))


def least(values: Floats) -> tuple[Floats, Floats, Floats]:
    return values.min(axis=0), values.min(axis=0), values.max(axis=0)


def test_a_run_without_an_evaluation_names_the_remedy(tmp_path: Path):
    run = EvaluatedRun(tmp_path / "run")
    with pytest.raises(RunDirectoryError, match="run is not evaluated; make it with: make eval RU"):
        _ = run.evaluation
    (evaluated(tmp_path / "run") / "evaluation.json").write_text("{")
    with pytest.raises(RunDirectoryError, match=r"evaluation\.json is not an evaluation"):
        load_run(tmp_path / "run")


def test_a_figure_is_of_all_evaluations_or_of_none():
    told, silent = evaluation_of({}, own=1.0), evaluation_of({})
    runs = [EvaluatedRun(Path("run"), found) for found in (told, silent, None)]
    assert RunGroup("row", (runs[0], runs[2])).figures("own") == [1.0]
    assert RunGroup("row", tuple(runs)).figures("own") == []


def test_settings_tell_what_an_evaluation_does_not():
    settings = {"loss.bc_weight.init": 2.0, "task.name": "pen", "variant": "sac"}
    run = EvaluatedRun(Path("run"), evaluation_of({"env": "door"}), settings=settings)
    assert [run.told(key) for key in ("task", "bc_weight", "variant")] == ["door", 2.0, "bc"]


def test_a_curve_goes_as_far_as_the_shortest_at_the_places_of_the_first():
    found = curve_of(
        group(
            [{"frames": 0, "y": 1.0}, {"frames": 10, "y": 3.0}, {"frames": 30, "y": 9.0}],
            [{"frames": 0, "y": 2.0}, {"frames": 8, "y": 7.0}, {"frames": 20, "y": 0.0}],
            [{"frames": 0, "y": None}, {"frames": 1}],  # tells nothing
        ),
        "y",
        statistic=least,
    )
    assert found is not None
    assert found.x.tolist() == [0.0, 10.0]
    assert (found.mean.tolist(), found.high.tolist()) == ([1.0, 3.0], [2.0, 7.0])


def test_a_curve_over_time_has_an_even_grid():
    points = [{"frames": f, "wall_s": w, "y": y} for f, w, y in ((0, 1.0, 5.0), (9, 8.0, 6.0))]
    found = curve_of(group(points), "y", "wall_s", points=5)
    assert found is not None
    assert found.x.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert found.mean.tolist() == [5.0, 5.0, 5.0, 5.0, 6.0]
    assert np.array_equal(found.low, found.high)
    assert curve_of(group(points), "z") is None


def test_the_last_value_is_the_last_that_is_told():
    told = [{"frames": 0, "y": 1.0}, {"frames": 1, "y": 3.0}, {"frames": 2, "y": None}]
    assert last_of(group(told, [{"frames": 0, "y": 5.0}], []), "y") == 4.0
    assert last_of(group([]), "y") is None
