"""Environments that act with the mean action beside those that sample, and a part of the noise."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from pipeline.act.exploration import EpisodeNoise, PartlyGreedyPolicy
from pipeline.learn.networks import make_actor
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, built, tiny_config


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
    with pytest.raises(
        ValueError, match=r"greedy_envs( must be between 0 and env\.num_envs=2|=-1)"
    ):
        built(tiny_config("sac", tmp_path, demos, f"collector.greedy_envs={greedy}"))
    assert not (tmp_path / "sac").exists()


def test_a_run_collects_with_it(tmp_path: Path, demos: Path):
    """Without noise the same door and policy give the same actions; with it they do not."""
    batches = []
    for greedy in (1, 2):
        folder = tmp_path / str(greedy)
        run = built(tiny_config("bc_sac", folder, demos, f"collector.greedy_envs={greedy}"))
        batches.append(next(iter(run.trainer.collector))["action"])
        run.trainer.collector.shutdown()
    assert torch.equal(batches[0][0], batches[1][0])
    assert not torch.equal(batches[0][1], batches[1][1])


def noise(actor: ProbabilisticActor, scale: float = 1.0, steps: int = 1, **begun) -> Tensor:
    """What was drawn [steps, N, A]: the policy's standard score of the actions."""
    acting = EpisodeNoise(actor, seed=7, scale=scale)
    begun = {"first": 0, "count": 4} | begun
    acting.begin(**begun)
    td = observations(begun["count"])
    policy = actor.get_dist(td)
    actions = torch.stack([acting(td)["action"].clone() for _ in range(steps)])
    return (actions.atanh() - policy.loc) / policy.scale


@pytest.fixture(scope="module")
def narrow_actor() -> ProbabilisticActor:
    """Whose samples stay where float32 can tell them from the edges."""
    torch.manual_seed(0)
    return make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8], log_std_max=-2.0)


def test_the_noise_of_an_episode_is_its_own(narrow_actor: ProbabilisticActor):
    steps = EpisodeNoise.AT_ONCE + 6
    together = noise(narrow_actor, steps=steps)
    for first, count in ((0, 1), (1, 2), (3, 1)):
        alone = noise(narrow_actor, steps=steps, first=first, count=count)
        torch.testing.assert_close(alone, together[:, first : first + count], atol=1e-3, rtol=0)
    rows = together.reshape(-1, ACTION_SIZE)
    assert torch.cdist(rows, rows).fill_diagonal_(1.0).min() > 1e-3  # no draw comes twice


def test_the_noise_is_standard_normal_times_the_scale(narrow_actor: ProbabilisticActor):
    whole, half = (noise(narrow_actor, scale, steps=1000) for scale in (1.0, 0.5))
    assert abs(whole.mean()) < 0.04
    assert abs(whole.std() - 1.0) < 0.04
    torch.testing.assert_close(half, 0.5 * whole, atol=1e-3, rtol=0)


def test_episodes_that_did_not_begin_are_not_acted_in(narrow_actor: ProbabilisticActor):
    acting = EpisodeNoise(narrow_actor, seed=0)
    acting.begin(0, 3)
    with pytest.raises(RuntimeError, match="4 episodes are stepped, and 3 have begun"):
        acting(observations(4))


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_no_part_of_the_noise_is_the_mean_action_and_is_refused(scale: float):
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    with pytest.raises(ValueError, match=r"noise_scale must be positive.*exploration=mean"):
        EpisodeNoise(actor, 0, scale)
