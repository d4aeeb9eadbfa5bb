"""Training whose episodes differ: said in the recipe, resumed bit for bit, never in evaluations."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import yaml

from configs import compose
from envs.disturbed import DisturbedEnv
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.run_files import RunDirectoryError
from pipeline.playing import make_training_env
from pipeline.recipe import Recipe
from tests.pipeline.resuming import curve_of, differences, everything, whole_and_halved
from tests.pipeline.toys import built, tiny_config, where

RANDOM = (
    "task.randomise.observation_noise=[0,0.02]",
    "task.randomise.action_noise=[0,0.1]",
    "task.randomise.delay=[0,3]",
    "task.randomise.factors.contact_friction=[0.5,2]",
    "task.randomise.factors.mass=[0.7,1.5]",
    "task.randomise.outside.door_x=[-0.02,0.05]",
)


def test_a_resumed_run_is_the_uninterrupted_one(tmp_path: Path, demos: Path):
    whole, halved = whole_and_halved(tmp_path, demos, *RANDOM)
    assert differences(everything(halved), everything(whole)) == []
    assert curve_of(halved.run_dir) == curve_of(whole.run_dir)


def test_the_recipe_keeps_what_was_asked_for(tmp_path: Path, demos: Path):
    run = built(tiny_config("sac", tmp_path, demos, *RANDOM))
    saved = yaml.safe_load((run.run_dir / "config.yaml").read_text())["task"]["randomise"]
    assert saved["delay"] == [0, 3]
    assert saved["factors"] == {"contact_friction": [0.5, 2.0], "mass": [0.7, 1.5]}
    assert saved["outside"] == {"door_x": [-0.02, 0.05]}
    assert isinstance(run.trainer.collector.env, DisturbedEnv)
    again = tiny_config("sac", tmp_path, demos, *RANDOM[:-1])
    with pytest.raises(RunDirectoryError, match=r"task\.randomise"):
        built(again, resume=True)


def test_evaluations_play_the_task_as_it_is(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, *RANDOM)
    built(config).train()
    told = evaluate_run(where(config), episodes=3)
    plain = evaluate_run(where(config), ["task.randomise.delay=[0,0]"], episodes=3)
    off = Recipe().task.randomise
    task = config.changed(task={"randomise": off}).find_task()
    assert type(task.make_env) is type(config.find_task().make_env)
    assert told["return_mean"] == plain["return_mean"]


def test_it_is_off_by_default():
    recipe = compose("variant=best")
    assert not recipe.task.randomise.disturbance
    env = make_training_env(recipe, recipe.find_task())
    assert not isinstance(env, DisturbedEnv)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("task.randomise.outside.door_z=[-0.02,0]", r"task\.randomise\.outside\.door_z.*table"),
        ("task.randomise.factors.weight=[1,2]", r"task\.randomise\.factors\.weight is unknown"),
        ("task.randomise.delay=[3,1]", r"task\.randomise\.delay"),
        ("task.randomise.delay=[-1,1]", r"task\.randomise\.delay"),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(override: str, told: str):
    with pytest.raises(ValueError, match=told):
        compose(override).find_task()


def test_training_sees_other_episodes(tmp_path: Path, demos: Path):
    plain = built(tiny_config("sac", tmp_path / "plain", demos))
    noisy = built(tiny_config("sac", tmp_path / "noisy", demos, *RANDOM[:1]))
    for run in (plain, noisy):
        run.train()
    seen = [run.trainer._modules["main_buffer"][:]["observation"] for run in (plain, noisy)]
    assert not torch.equal(*seen)
