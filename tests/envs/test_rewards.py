"""A task's other reward, in its environments and its demonstrations alike."""

from __future__ import annotations

import numpy as np
import pytest

from envs import EnvOptions, find_task
from envs.demonstrations.loading import DemoOptions, load_demonstrations
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.rewards import rewarded
from pipeline.recipe import Recipe

MULTIPLY = MultiplyConfig(target_episodes=2, max_attempts=64, seed=0)


@pytest.mark.parametrize("resimulate", [True, False])
def test_demonstrations_pay_it_too(resimulate):
    options = DemoOptions(limit=2, resimulate=resimulate)
    sparse = load_demonstrations("bundled", rewarded(find_task("door"), "sparse"), options)
    dense = load_demonstrations("bundled", find_task("door"), options)
    for episode, own in zip(sparse.episodes, dense.episodes, strict=True):
        np.testing.assert_array_equal(episode.observations, own.observations)
        np.testing.assert_array_equal(episode.rewards, episode.success[1:].astype(np.float32) - 1)
    assert sparse.content_hash != dense.content_hash


def test_multiplied_episodes_pay_it_and_are_cached_apart(tmp_path):
    options = DemoOptions(limit=20, multiply=MULTIPLY, resimulate=False)
    for kind in (None, "sparse"):
        task = rewarded(find_task("door"), kind)
        loaded = load_demonstrations("bundled", task, options, cache_dir=tmp_path)
        paid = np.concatenate([episode.rewards for episode in loaded.episodes])
        assert (set(paid.tolist()) <= {-1.0, 0.0}) == (kind == "sparse")


def test_the_same_speeds_are_tried_for_it():
    options = DemoOptions(limit=2, resimulate=False)
    episodes = load_demonstrations("bundled", find_task("door"), options).episodes
    wanted, slow_half = np.ones(2), np.array([[1.0, 0.0], [1.0, 0.0]])
    drawn = []
    for kind in (None, "sparse"):
        with rewarded(find_task("door"), kind).vary.open(episodes, MULTIPLY, 1) as player:
            drawn.append([player.draw(k, wanted, slow_half).speed for k in range(8)])
    assert drawn[0] == drawn[1]
    assert max(drawn[1]) <= (MULTIPLY.speed_low + MULTIPLY.speed_high) / 2


def test_a_recipe_names_it():
    recipe = Recipe().changed(env={"reward": "sparse"})
    for made in (recipe, Recipe.of(recipe.plain(), "saved")):
        env = made.find_task().make_env(EnvOptions(seed=0))
        assert env.step(env.rand_action(env.reset()))["next", "reward"].tolist() == [[-1.0]]
    own = Recipe().find_task().make_env(EnvOptions(seed=0))
    assert own.step(own.rand_action(own.reset()))["next", "reward"].item() > -1.0
    with pytest.raises(ValueError, match=r"env\.reward='scarce'"):
        Recipe().changed(env={"reward": "scarce"})


def test_its_own_is_the_task_itself():
    task = find_task("door")
    assert rewarded(task, None) is task
    assert rewarded(task, "dense") is task
