"""Environments that act with the mean action beside those that sample, and a part of the noise."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pipeline.build import build_run
from pipeline.exploration import PartlyGreedyPolicy, with_noise
from pipeline.networks import make_actor
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, tiny_config


def observations(count: int) -> TensorDict:
    observation = torch.randn(count, OBSERVATION_SIZE, generator=torch.Generator().manual_seed(0))
    return TensorDict({"observation": observation}, [count])


@pytest.mark.parametrize("greedy", [0, 2, 4])
def test_the_first_environments_take_the_mean_action_and_the_others_sample(greedy: int):
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    policy = PartlyGreedyPolicy(actor, greedy, num_envs=4)
    mean = actor.get_dist(observations(4)).deterministic_sample
    acted = [policy(observations(4))["action"] for _ in range(2)]
    for action in acted:
        assert torch.equal(action[:greedy], mean[:greedy])
        assert (action[greedy:] != mean[greedy:]).any(-1).all()
    assert (acted[0][greedy:] != acted[1][greedy:]).any(-1).all()


def test_it_acts_with_the_weights_that_are_being_trained():
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    policy = PartlyGreedyPolicy(actor, 1, num_envs=1)
    before = policy(observations(1))["action"]
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.5)
    assert not torch.equal(policy(observations(1))["action"], before)


@pytest.mark.parametrize("greedy", [-1, 3])
def test_more_than_there_are_is_refused(greedy: int, tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, f"collector.greedy_envs={greedy}")
    with pytest.raises(ValueError, match=r"greedy_envs must be between 0 and env\.num_envs=2, got"):
        build_run(config)
    assert not Path(config.run_dir).exists()


def test_a_run_collects_with_it(tmp_path: Path, demos: Path):
    """Without noise the same door and policy give the same actions; with it they do not."""
    batches = []
    for greedy in (1, 2):
        overrides = [f"collector.greedy_envs={greedy}", f"run_dir='{tmp_path / str(greedy)}'"]
        run = build_run(tiny_config("bc_sac", tmp_path, demos, *overrides))
        batches.append(next(iter(run.trainer.collector))["action"])
        run.trainer.collector.shutdown()
    assert torch.equal(batches[0][0], batches[1][0])
    assert not torch.equal(batches[0][1], batches[1][1])


def test_a_part_of_the_noise_is_added_before_the_tanh():
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    policy = actor.get_dist(observations(4))
    with set_exploration_type(ExplorationType.RANDOM):
        torch.manual_seed(5)
        action = with_noise(actor, 0.5)(observations(4))["action"]
    torch.manual_seed(5)
    drawn = torch.randn(4, ACTION_SIZE)
    expected = torch.tanh(policy.loc + 0.5 * policy.scale * drawn)
    torch.testing.assert_close(action, expected)


def test_a_part_of_the_noise_leaves_the_policy_and_its_mean_as_they_were():
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    before = actor.get_dist(observations(4)).scale
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        quiet = with_noise(actor, 0.5)(observations(4))["action"]
        assert torch.equal(quiet, actor(observations(4))["action"])
    assert torch.equal(actor.get_dist(observations(4)).scale, before)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_no_part_of_the_noise_is_the_mean_action_and_is_refused(scale: float):
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    with pytest.raises(ValueError, match=r"noise_scale must be positive.*exploration=mean"):
        with_noise(actor, scale)
