"""The lab: its notes, its data, and that the two belong together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from docs.lab import data
from docs.site import lab
from docs.site.page import Page
from pipeline.results.reading import read_runs
from pipeline.results.runs import EvaluatedRun
from tests.pipeline.results.evaluated import evaluation_of

HEADINGS = ["Change", "Result", "Decision", "Data"]


def content(seed: int, success: list[float | None]) -> dict[str, object]:
    """What is published of a run, with every kind of value: numbers, none, lists, text."""
    return {
        "episodes": 1000,
        "return_mean": 1.5 + seed,
        "angle_mean_deg_opened": None,
        "share_gt_1_35": 0.25,
        "share_gt_1_35_ci95": [0.2, 0.3],
        "made_from": {"seed": seed, "run": "runs/x", "task": "door"},
        "alarms": [{"frames": 3}] if seed else [],
        "curve": {"frames": list(range(len(success))), "share_gt_1_35": success},
    }


@pytest.mark.parametrize("note", lab.notes(), ids=lambda note: note.path.stem)
def test_a_note_is_one_question_with_its_parts(note: Page):
    assert note.title.endswith("?")
    assert [line[3:] for line in note.text.splitlines() if line.startswith("## ")] == HEADINGS
    assert note.about["decision"] in lab.DECISIONS
    shows = "<!-- generated: runs -->" in note.text
    assert shows == bool(note.about["rows"]), "a note shows the runs that it names"


def test_every_row_of_the_data_is_in_a_note_and_the_other_way_round():
    told = {name for note in lab.notes() for name in note.about["rows"]}
    assert told == set(lab.rows())


def test_notes_are_numbered_without_a_gap():
    assert [int(note.path.name[:2]) for note in lab.notes()] == list(range(1, len(lab.notes()) + 1))


def test_what_is_saved_is_loaded_as_it_was(tmp_path: Path):
    rows = {
        "a": {0: content(0, [0.5, None]), 3: content(3, [])},
        "b": {1: content(1, [1.0, 0.0, 0.5])},
    }
    data.save(rows, tmp_path / "runs.parquet")
    assert json.dumps(data.load(tmp_path / "runs.parquet")) == json.dumps(rows)


def test_a_row_that_is_exported_is_what_a_report_reads(tmp_path: Path):
    data.export(["dbc_wide"], tmp_path)
    runs = read_runs([tmp_path])
    assert [run.name for run in runs] == ["dbc_wide/seed1.json", "dbc_wide/seed2.json"]
    assert not any(run.missing for run in runs)
    assert data.read_folder(tmp_path) == {"dbc_wide": data.load()["dbc_wide"]}


@pytest.mark.parametrize(
    ("success", "lowest"),
    [
        ([0.2, 0.95, 0.7, 0.9], 0.7),
        ([0.2, 0.9], 0.9),
        ([0.1, 0.89], None),
        ([], None),
        ([1.0, None, 0.4], 0.4),
    ],
)
def test_the_lowest_evaluation_counts_after_ninety_per_cent(
    success: list[float | None], lowest: float | None
):
    curve = tuple({"frames": k, "share_gt_1_35": share} for k, share in enumerate(success))
    assert lab.lowest(EvaluatedRun(Path("run"), evaluation_of({}), curve)) == lowest


def test_a_table_has_the_means_and_the_worst_seed():
    row = data.load()["best_heads"]
    shares = [row[seed]["share_gt_1_35"] for seed in (6, 8)]
    assert shares == [0.959, 0.966], "of the published files"
    line = lab.results(["best_heads"]).splitlines()[2]
    assert line.startswith("| `best_heads` | 2 | 100,000 | - | 96.2 % | 95.9 % | 1,880 |")
