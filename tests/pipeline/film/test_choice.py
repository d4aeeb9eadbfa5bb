from __future__ import annotations

from pathlib import Path

import pytest

from envs.door.definition import TASK
from pipeline.files.run_files import EVALUATION, RunDirectoryError
from pipeline.film.choice import Choice, worst_of
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import RunEvaluation, episode_columns
from tests.pipeline.report.making import rollouts


def evaluated(folder: Path, seed: int = 20_000) -> Path:
    """Of ten doors, the first five succeed."""
    made_from = {"run": "x", "variant": "bc", "seed": 0, "task": "door", "evaluation_seed": seed}
    columns = episode_columns(TASK, rollouts(5, 10), seed=seed)
    metrics = {"episodes": 10, "made_from": made_from}
    RunEvaluation(metrics, columns, {}).write(folder / EVALUATION)
    return folder


def test_failures_come_first_then_who_got_least_far_then_the_lowest_return():
    columns = {
        "episode": [10.0, 11.0, 12.0, 13.0, 14.0],
        "success_once": [1, 0, 0, 1, 0],
        "progress_max": [1.4, 0.2, 0.0, 1.5, 0.2],
        "return": [9.0, -3.0, 5.0, 1.0, -4.0],
    }
    assert worst_of(columns) == [12, 14, 11, 10, 13]
    without = {key: columns[key] for key in ("episode", "return")}
    assert worst_of(without) == [14, 11, 13, 12, 10]


def test_the_worst_are_those_of_the_evaluation(tmp_path: Path):
    assert Choice(worst=3).numbers(evaluated(tmp_path), Recipe()) == [5, 6, 7]


def test_without_an_evaluation_its_command_is_said(tmp_path: Path):
    with pytest.raises(RunDirectoryError, match=r"make eval RUN="):
        Choice(worst=1).numbers(tmp_path, Recipe())
    with pytest.raises(RunDirectoryError, match=r"evaluation_seed 7, not 20000.*make eval RUN="):
        Choice(worst=1).numbers(evaluated(tmp_path, seed=7), Recipe())


@pytest.mark.parametrize(
    ("given", "numbers"),
    [((None, None, None), [0, 1, 2]), ((2, None, None), [0, 1]), ((None, "17,3", None), [17, 3])],
)
def test_numbers_of_the_list(given: tuple, numbers: list[int], tmp_path: Path):
    assert Choice.parse(*given).numbers(tmp_path, Recipe()) == numbers


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((2, "3", None), r"EPISODES=2 and STARTS=3 each say"),
        ((None, "3", 1), r"STARTS=3 and WORST=1"),
        ((0, None, None), r"EPISODES=0 must be at least 1"),
        ((None, None, 0), r"WORST=0 must be at least 1"),
        ((None, "3,x", None), r"STARTS=3,x is no list"),
        ((None, "-1", None), r"STARTS=-1: episodes are numbered from 0"),
        ((None, "", None), r"STARTS= names no episode"),
    ],
)
def test_what_cannot_be_chosen(given: tuple, told: str):
    with pytest.raises(ValueError, match=told):
        Choice.parse(*given)


@pytest.mark.parametrize(
    ("choice", "needs"),
    [(Choice(4), None), (Choice(starts=(1, 2)), "STARTS=1,2"), (Choice(worst=2), "WORST=2")],
)
def test_what_needs_numbered_episodes(choice: Choice, needs: str | None):
    assert choice.needs_list == needs
