"""Demonstrations that were executed with noise: which action a run's parts see."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from envs.demonstrations import read_recording, write_recording
from envs.door.demos import SCHEMA
from tests.pipeline.toys import built, tiny_config


@pytest.fixture
def noisy(demos: Path, tmp_path: Path) -> Path:
    """The tests' recording; of every clean action, 0.25 more was executed."""
    episodes = [
        dataclasses.replace(episode, executed_actions=episode.actions + np.float32(0.25))
        for episode in read_recording(demos, SCHEMA)
    ]
    write_recording(tmp_path / "noisy.h5", episodes, {"made_by": "the tests"})
    return tmp_path / "noisy.h5"


@pytest.mark.parametrize(
    ("variant", "options"),
    [("dbc_sac", []), ("dbc_sac", ["demos.resimulate=false"]), ("da_sac", []), ("sid_dbc", [])],
)
def test_a_batch_holds_both_actions(variant: str, options: list[str], noisy: Path, tmp_path: Path):
    run = built(tiny_config(variant, tmp_path, noisy, *options))
    batches = []
    step = run.trainer.optimization_stepper.step

    def watched(trainer: object, batch: object) -> object:
        batches.append(batch)
        return step(trainer, batch)

    run.trainer.optimization_stepper.step = watched
    run.train()
    for batch in batches:
        if "is_demo" not in batch:
            continue
        is_demo = batch["is_demo"].squeeze(-1)
        if not is_demo.any():
            continue
        apart = batch["action"] - batch["imitated_action"]
        assert (apart[~is_demo] == 0).all()
        # Grown rows are the policy's own.
        own = (apart[is_demo] == 0).all(-1)
        assert variant.startswith("sid") or not own.any()
        torch.testing.assert_close(apart[is_demo][~own], torch.full_like(apart, 0.25)[: sum(~own)])
    assert batches


def test_clean_actions_alone_are_what_there_was_before(noisy: Path, demos: Path, tmp_path: Path):
    """With recorded states, all else is equal."""
    options = ("demos.resimulate=false", "demos.critic_action=clean")
    run = built(tiny_config("dbc_sac", tmp_path / "a", noisy, *options))
    plain = built(tiny_config("dbc_sac", tmp_path / "b", demos, options[0]))
    for one in (run, plain):
        torch.manual_seed(0)
        one.train()
    assert all(
        torch.equal(a, b)
        for a, b in zip(run.actor.parameters(), plain.actor.parameters(), strict=True)
    )


def test_another_word_is_refused(noisy: Path, tmp_path: Path):
    with pytest.raises(ValueError, match=r"demos\.critic_action='noisy': .*'executed' or 'clean'"):
        tiny_config("dbc_sac", tmp_path, noisy, "demos.critic_action=noisy")
