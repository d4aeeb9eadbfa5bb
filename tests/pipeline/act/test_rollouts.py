"""Whole episodes of a policy, which become demonstrations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase

from configs import compose
from envs import EnvOptions
from pipeline.act.rollouts import MAX_BATCH, rollout_episodes, rollout_waves
from pipeline.commands.demonstrator import Demonstrator
from pipeline.commands.record import record_demonstrations
from tests.toys import reach

TOY = f"task.name='{Path(reach.__file__)}'"


still = TensorDictModule(lambda seen: torch.zeros(*seen.shape[:-1], 2), ["observation"], ["action"])


class Made(Exception):  # noqa: N818 - ends the making
    """With the options that an environment was to be made with."""


def refused(options: EnvOptions) -> None:
    raise Made(options)


def test_recorded_episodes_are_of_the_environment_that_was_asked_for(tmp_path: Path):
    keys = ["env.workers=3", "env.num_threads=2", "env.horizon=9"]
    demonstrator = Demonstrator.of_controller(f"{reach.__file__}:controller", [TOY, *keys])
    demonstrator = replace(demonstrator, task=replace(demonstrator.task, make_env=refused))
    with pytest.raises(Made) as made:
        record_demonstrations(demonstrator, str(tmp_path / "x.h5"), episodes=4, attempts=5, seed=7)
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


def test_copies_are_made_once_and_closed_whenever_it_ends():
    made: list[EnvBase] = []
    closed: list[EnvBase] = []

    def make(options: EnvOptions) -> EnvBase:
        env = reach.TASK.make_env(options)
        made.append(env)
        env.close = lambda: closed.append(env)
        return env

    task = replace(reach.TASK, make_env=make, max_copies=3)
    # By its numbers: what a list holds does not depend on how many are played at once.
    whole = rollout_episodes(still, task=replace(task, max_copies=None), episodes=8, seed=2)
    waves = rollout_waves(lambda: still, task=task, episodes=8, seed=2)
    assert [len(wave) for wave in waves] == [3, 3, 2]
    waved = rollout_episodes(still, task=task, episodes=8, seed=2)
    for one, other in zip(whole, waved, strict=True):
        assert torch.equal(one.trajectory["observation"], other.trajectory["observation"])
    assert len(made) == 3
    stopped = rollout_waves(lambda: still, task=task, episodes=8, seed=2)
    next(stopped)
    assert len(closed) == 3
    stopped.close()
    assert closed == made
