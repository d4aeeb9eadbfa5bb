"""What training says of demonstrations that it loads."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest

from envs import Task
from envs.demonstrations import DemonstrationError
from pipeline.data.demonstrations import Demonstrations, DemosSettings, make_demonstrations
from pipeline.data.rows import TransitionRows
from tests.envs.demonstrations.files_of_others import SCHEMA, toy_episode, write_npz


def no_env(_: object):
    raise AssertionError("needs no environment")


def test_training_warns_of_actions_that_look_normalised_and_uses_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    wide = dataclasses.replace(SCHEMA, action_low=(-5.0, -5.0), action_high=(5.0, 5.0))
    task = Task(name="toy", make_env=no_env, demos=wide)
    path = write_npz(tmp_path / "n.npz", [toy_episode(0)])
    with caplog.at_level(logging.WARNING):
        loaded = make_demonstrations(
            DemosSettings(source=str(path)),
            task,
            TransitionRows(gamma=0.99),
            cache_dir=tmp_path,
            num_threads=1,
        )
    assert len(loaded.episodes) == 1
    assert np.abs(loaded.episodes[0].actions).max() < 0.2
    (said,) = [record.getMessage() for record in caplog.records]
    assert "n.npz: all actions lie within [-1, 1], and the task's within [-5, 5]" in said
    assert "\n" not in said


def test_episodes_that_do_not_pass_are_left_out_and_counted_where_that_is_asked_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    task = Task(name="toy", make_env=no_env, demos=SCHEMA)
    episodes = [toy_episode(i) for i in range(3)]
    episodes[1].actions[0, 1] = 7.0

    def loaded(**demos: object) -> Demonstrations:
        settings = DemosSettings(source=str(tmp_path / "n.npz"), **demos)
        rows = TransitionRows(gamma=0.99)
        return make_demonstrations(settings, task, rows, cache_dir=tmp_path, num_threads=1)

    write_npz(tmp_path / "n.npz", episodes)
    with pytest.raises(DemonstrationError, match="is 7, its bounds are -1 and 1"):
        loaded()
    with caplog.at_level(logging.WARNING):
        kept = loaded(skip_refused=True)
    assert [episode.provenance.episode for episode in kept.episodes] == [0, 2]
    assert "1 of 3 episodes" in caplog.text
    assert "is 7, its bounds are -1 and 1" in caplog.text
    write_npz(tmp_path / "n.npz", episodes[1:2])
    with pytest.raises(DemonstrationError, match="is 7"):
        loaded(skip_refused=True)


def test_training_tells_what_it_trains_on(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    task = Task(name="toy", make_env=no_env, demos=SCHEMA)
    episodes = [toy_episode(i) for i in range(3)]
    path = write_npz(tmp_path / "n.npz", episodes)
    with caplog.at_level(logging.INFO, "pipeline.data.demonstrations"):
        loaded = make_demonstrations(
            DemosSettings(source=str(path), held_out=1),
            task,
            TransitionRows(gamma=0.99),
            cache_dir=tmp_path,
            num_threads=1,
        )
    steps = episodes[0].length + episodes[1].length
    assert caplog.messages[-1] == f"demonstrations: 2 episodes, {steps} steps (1 more are held out)"
    assert len(loaded.episodes) == 2
