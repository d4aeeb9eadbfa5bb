"""A run and a group of runs: figures that all tell, and curves at places of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from losses.imitation_errors import IMITATION_ERRORS
from pipeline.files.run_files import RunDirectoryError
from pipeline.results.curves import AXES, DIAGNOSTICS, curve_of, curves_over, last_of
from pipeline.results.reading import load_run
from pipeline.results.runs import EvaluatedRun, RunGroup
from tests.pipeline.results.evaluated import evaluated, evaluation_of


def group(*curves: list[dict[str, Any]]) -> RunGroup:
    return RunGroup("row", tuple(EvaluatedRun(Path("run"), curve=curve) for curve in curves))


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
    )
    assert found is not None
    assert found.x.tolist() == [0.0, 10.0]
    assert (found.mean.tolist(), found.high.tolist()) == ([1.5, 5.0], [1.5, 5.0])


def test_a_curve_over_time_has_an_even_grid():
    points = [{"frames": f, "wall_s": w, "y": y} for f, w, y in ((0, 1.0, 5.0), (9, 8.0, 6.0))]
    found = curve_of(group(points), "y", "wall_s", points=5)
    assert found is not None
    assert found.x.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert found.mean.tolist() == [5.0, 5.0, 5.0, 5.0, 6.0]
    assert np.array_equal(found.low, found.high)
    assert curve_of(group(points), "z") is None


def over(key: str, *rows: RunGroup) -> dict[int, tuple[list[float], list[float]]]:
    """Places and means of the rows' curves over one axis."""
    (axis,) = (axis for axis in AXES if axis.key == key)
    return {n: (b.x.tolist(), b.mean.tolist()) for n, b in curves_over(rows, "y", axis).items()}


def of_frames(frames: int, *curves: list[dict[str, Any]]) -> RunGroup:
    evaluation = evaluation_of({"frames": frames})
    return RunGroup("row", tuple(EvaluatedRun(Path("r"), evaluation, c) for c in curves))


def point(frames: int, steps: int | None, wall_s: float, y: float) -> dict[str, Any]:
    told = {} if steps is None else {"simulator_steps": steps}
    return {"frames": frames, "wall_s": wall_s, "y": y, **told}


def test_a_curve_over_simulator_steps_begins_where_demonstrations_end():
    learner = of_frames(100, [point(0, 500, 60.0, 0.2), point(100, 600, 120.0, 0.8)])
    assert over("frames", learner) == {0: ([0, 100], [0.2, 0.8])}
    assert over("simulator_steps", learner) == {0: ([500, 600], [0.2, 0.8])}
    assert over("wall_s", learner) == {0: ([1, 2], [0.2, 0.8])}  # min


def test_a_clone_is_a_level_over_what_it_does_not_spend():
    learner = of_frames(100, [point(0, 500, 60.0, 0.2), point(100, 600, 120.0, 0.8)])
    clone = of_frames(0, [point(0, 450, 6.0, 0.0), point(5000, 450, 30.0, 0.7)])
    assert over("frames", learner, clone)[1] == ([0, 100], [0.7, 0.7])
    assert over("simulator_steps", learner, clone)[1] == ([450, 600], [0.7, 0.7])
    assert over("wall_s", learner, clone)[1] == ([0.1, 0.5], [0.0, 0.7])
    # Alone it is all that there is to see.
    assert over("frames", clone)[0] == ([0, 5000], [0.0, 0.7])
    assert over("simulator_steps", clone)[0] == ([450], [0.7])


def test_what_nobody_counted_is_no_curve():
    older = of_frames(100, [point(0, None, 1.0, 0.2), point(100, None, 2.0, 0.8)])
    both = of_frames(100, [point(0, 5, 1.0, 0.2)], [point(0, None, 1.0, 0.2)])
    assert over("simulator_steps", older, both) == {}
    assert list(over("frames", older, both)) == [0, 1]


def test_the_last_value_is_the_last_that_is_told():
    told = [{"frames": 0, "y": 1.0}, {"frames": 1, "y": 3.0}, {"frames": 2, "y": None}]
    assert last_of(group(told, [{"frames": 0, "y": 5.0}], []), "y") == 4.0
    assert last_of(group([]), "y") is None


def test_an_imitation_error_that_is_not_in_nats_is_named_where_it_is_drawn():
    """Its keys are the same whatever ``loss.imitation`` is; the label has the unit of each."""
    others = {name for name, error in IMITATION_ERRORS.items() if "nats" not in str(error.__doc__)}
    assert others == {"mse"}
    (panel,) = (panel for panel in DIAGNOSTICS if "bc_nll_train" in panel.keys)
    assert "(nats; mse: squared action)" in panel.title
