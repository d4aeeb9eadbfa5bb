"""Whole episodes of a policy, which become demonstrations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from configs import compose
from envs import EnvOptions
from pipeline.act.rollouts import MAX_BATCH, rollout_episodes
from pipeline.commands.acting import Acting
from pipeline.commands.record import record_demonstrations
from tests.toys import reach

TOY = f"task.name='{Path(reach.__file__)}'"


class Made(Exception):  # noqa: N818 - ends the making
    """With the options that an environment was to be made with."""


def refused(options: EnvOptions) -> None:
    raise Made(options)


def test_recorded_episodes_are_of_the_environment_that_was_asked_for(tmp_path: Path):
    keys = ["env.workers=3", "env.num_threads=2", "env.horizon=9"]
    acting = Acting.of_controller(f"{reach.__file__}:controller", [TOY, *keys])
    acting = replace(acting, task=replace(acting.task, make_env=refused))
    with pytest.raises(Made) as made:
        record_demonstrations(acting, str(tmp_path / "x.h5"), episodes=4, attempts=5, seed=7)
    expected = EnvOptions(num_envs=5, seed=7, device="cpu", num_threads=2, workers=3, horizon=9)
    assert made.value.args == (expected,)


def test_more_episodes_than_fit_are_played_in_waves():
    task = replace(reach.TASK, make_env=refused)
    with pytest.raises(Made) as made:
        rollout_episodes(None, task=task, episodes=10 * MAX_BATCH, seed=0)
    assert made.value.args[0].num_envs == MAX_BATCH


def test_the_options_of_a_run_leave_out_what_is_for_training_alone():
    recipe = compose("variant=sac", "env.num_envs=7", "env.success_steps=4", "env.workers=2")
    options = recipe.env_options(seed=5)
    assert options == EnvOptions(
        num_envs=1, seed=5, workers=2, horizon=recipe.env.horizon, device=recipe.device,
        num_threads=recipe.env.num_threads,
    )  # fmt: skip
