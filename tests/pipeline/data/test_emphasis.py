"""Demonstrated steps before and after the task has progressed so far."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from configs import compose
from envs import find_task
from pipeline.conversion import make_emphasis
from pipeline.data.emphasis import ProgressEmphasis
from pipeline.playing import make_training_env


def at(*progress: float) -> TensorDict:
    return TensorDict({"progress": torch.tensor(progress).unsqueeze(-1)}, [len(progress)])


def test_the_factor_changes_beyond_the_progress():
    emphasis = ProgressEmphasis(before=0.5, beyond=2.0, progress=0.02)
    assert emphasis(at(-0.01, 0.0, 0.019, 0.021, 1.5)).tolist() == [0.5, 0.5, 0.5, 2.0, 2.0]


@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan])
@pytest.mark.parametrize("name", ["before", "beyond"])
def test_a_bad_factor_is_named(name: str, value: float):
    with pytest.raises(ValueError, match=rf"loss\.bc_emphasis\.{name} must be .* got {value}"):
        ProgressEmphasis(**({"before": 1.0, "beyond": 1.0, "progress": 0.1} | {name: value}))


def configured(*overrides: str) -> ProgressEmphasis | None:
    return make_emphasis(compose("variant=bc_sac", "preset=smoke", *overrides))


def test_what_is_configured_is_made():
    options = ["loss.bc_emphasis.before=0.5", "loss.bc_emphasis.progress=0.1"]
    assert configured(*options) == ProgressEmphasis(before=0.5, beyond=1.0, progress=0.1)


def test_alike_means_none():
    assert configured("loss.bc_emphasis.progress=0.1") is None


@pytest.mark.parametrize("asked", ["loss.bc_emphasis.beyond=2.0", "loss.progress_bonus=2.0"])
def test_a_task_without_progress_is_refused(asked: str):
    name = "gymnasium:Pendulum-v1"
    recipe = compose("variant=bc_sac", "preset=smoke", f"task.name='{name}'", asked)
    with pytest.raises(ValueError, match=rf"{asked} needs a task that tells its progress.*{name}"):
        make_training_env(recipe, find_task(name))
