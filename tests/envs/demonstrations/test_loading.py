"""From a file to the set that training uses, and the table about it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from envs.demonstrations import (
    MultiplyConfig,
    content_hash,
    format_reports,
)
from envs.door import task
from tests.envs.demonstrations.helpers import load_door, raw_demo, write_pickle


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_pickle(tmp_path / "d.pickle", [raw_demo(0), raw_demo(1, steps=7)])


def test_resimulated_by_default(path: Path) -> None:
    loaded = load_door(path)
    assert [e.provenance.kind for e in loaded.episodes] == ["resimulated"] * 2
    assert loaded.transitions == 11 + 6
    assert loaded.source == "d.pickle"
    assert loaded.content_hash == content_hash(loaded.episodes)
    for report in loaded.reports:
        assert report.replay_error_max > report.replay_error_median > 0
        assert report.clipped_entries > 0


def test_without_resimulation_the_reward_is_still_the_tasks(path: Path) -> None:
    loaded = load_door(path, resimulate=False)
    for episode in loaded.episodes:
        np.testing.assert_array_equal(episode.rewards, task.reward(episode.observations[1:]))
    assert all(math.isnan(report.replay_error_max) for report in loaded.reports)
    # The file's own rewards are random here; the report is about those.
    assert all(report.reward_agreement < 0.5 for report in loaded.reports)


def test_limit(path: Path) -> None:
    assert len(load_door(path, limit=1).episodes) == 1
    with pytest.raises(ValueError, match="limit must be at least 1"):
        load_door(path, limit=0)


def test_multiplied(path: Path, tmp_path: Path) -> None:
    config = MultiplyConfig(target_episodes=5, min_progress=-1.0, horizon=4, round_size=4)
    loaded = load_door(path, multiply=config, cache_dir=tmp_path / "cache")
    assert [e.provenance.kind for e in loaded.episodes] == ["multiplied"] * 5
    assert len(loaded.reports) == 2
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_table_has_a_row_per_demonstration(path: Path) -> None:
    loaded = load_door(path, resimulate=False)
    lines = format_reports(loaded.reports).splitlines()
    assert len(lines) == 2 + 2
    assert "return" in lines[0]
    assert "nan" not in lines[2]
    assert f"{loaded.reports[1].max_progress:.3f}" in lines[3]


def test_a_table_has_no_column_in_which_nothing_is_known(path: Path) -> None:
    loaded = load_door(path, resimulate=False)
    first, second = (replace(report, clipped_entries=0) for report in loaded.reports)
    assert "replay error" not in format_reports([first, second])
    assert "clipped" not in format_reports([first, second])
    known = replace(second, clipped_entries=3, replay_error_median=0.25)
    shown = format_reports([first, known]).splitlines()
    assert "clipped entries" in shown[0]
    assert "replay error (median)" in shown[0]
    assert "replay error (max)" not in shown[0]
    assert shown[2].split()[-3:-1] == ["0", "-"]
    assert shown[3].split()[-3:-1] == ["3", "0.25"]
