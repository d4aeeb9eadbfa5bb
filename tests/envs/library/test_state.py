"""MuJoCo environments go on in the middle of an episode; recorded episodes begin where they did."""

from __future__ import annotations

import logging

import gymnasium
import numpy as np
import pytest
import torch

from envs import EnvOptions, find_task
from envs.demonstrations.episode import Episode, Provenance
from envs.library.state import continues_exactly
from envs.options import TaskOptions
from envs.scaling import to_unit
from envs.task import TaskFailedError
from pipeline.files.checkpoint import resumes_midway
from tests.envs.library.making import make
from tests.envs.library.toys import HERE

pytestmark = pytest.mark.filterwarnings("ignore:.*settotalmass")
DOOR = "gymnasium:gymnasium_robotics:AdroitHandDoor-v1"


def opened(name, seed=0, workers=0, count=2, horizon=30):
    options = EnvOptions(num_envs=count, seed=seed, workers=workers, horizon=horizon)
    return find_task(name).make_env(options)


def play(env, td, actions):
    seen = []
    for action in actions:
        step, td = env.step_and_maybe_reset(td.set("action", action))
        seen.append(step["next"].select("observation", "reward", "done"))
    return torch.stack(seen), td


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize(
    "name",
    [
        *("gymnasium:HalfCheetah-v5", DOOR, "dm_control:reacher/easy"),
        *("gymnasium:Pendulum-v1", "gymnasium:MountainCarContinuous-v0", f"{HERE}/Drifts-v0"),
    ],
)
def test_a_resumed_run_is_the_uninterrupted_one(name, workers):
    """20 steps before, and 25 after, in which episodes of 30 steps end and others begin."""
    env = opened(name)
    assert resumes_midway(env)
    torch.manual_seed(0)
    actions = torch.rand(45, *env.action_spec.shape) * 2 - 1
    _, td = play(env, env.reset(), actions[:20])
    saved = {key: value.clone() for key, value in env.get_extra_state().items()}
    carried = td.clone()
    expected, _ = play(env, td, actions[20:])
    env.close()
    other = opened(name, seed=5, workers=workers)
    other.reset()
    other.set_extra_state(saved)
    found, _ = play(other, carried, actions[20:])
    assert expected["done"].any()
    for key in ("observation", "reward", "done"):
        assert torch.equal(found[key], expected[key]), key
    other.close()


class Forgetful(gymnasium.Wrapper):
    """Pays by how often it was stepped, which no state of MuJoCo holds."""

    def __init__(self, env):
        super().__init__(env)
        self.count = 0

    def step(self, action):
        self.count += 1
        observation, _, *rest = self.env.step(action)
        return observation, float(self.count), *rest


def test_what_keeps_more_than_its_simulation_is_not_trusted():
    assert continues_exactly(gymnasium.make("Hopper-v5"))
    assert not continues_exactly(Forgetful(gymnasium.make("Hopper-v5")))
    assert not continues_exactly(Forgetful(gymnasium.make("Pendulum-v1")))


@pytest.mark.parametrize(
    "name",
    ["CartPole-v1", "Pendulum-v1", "MountainCar-v0", "MountainCarContinuous-v0", "Acrobot-v1"],
)
def test_classic_control_of_gymnasium_goes_on(name):
    assert continues_exactly(gymnasium.make(name))


class Remembering(Forgetful):
    """The same, and can tell it."""

    def get_state(self):
        return self.count

    def set_state(self, state):
        self.count = state


@pytest.mark.parametrize("name", ["Hopper-v5", "Pendulum-v1", "Toys/Drifts-v0"])
def test_a_wrapper_that_tells_what_it_keeps_is_trusted(name):
    assert continues_exactly(Remembering(gymnasium.make(name)))


@pytest.mark.parametrize(
    ("kwargs", "why"),
    [
        ({"leaves_out": "hits"}, "an episode does not go on from them as it did"),
        ({"leaves_out": "own"}, "an episode does not go on from them as it did"),
        ({"leaves_out": "body"}, r"set_state() failed (KeyError: 'body')"),
        ({"holds": None}, r"get_state() failed (TypeError: holds is NoneType; a state is of arr"),
        ({"holds": np.array([{}])}, r"get_state() failed (TypeError: holds is an array of object"),
    ],
)
def test_what_an_environment_tells_of_its_state_is_tried(kwargs, why, caplog):
    with caplog.at_level(logging.WARNING, "envs.library"):
        env = make("Drifts", TaskOptions(kwargs=kwargs))
    assert not resumes_midway(env)
    assert f"Drifts-v0 offers get_state() and set_state(state), but {why}" in caplog.text


def test_a_state_that_no_longer_fits_is_told_with_its_copy():
    env = make("Drifts", num_envs=2)
    env.reset()
    env.copies.envs[1].unwrapped.holds = np.zeros(3)
    with pytest.raises(TaskFailedError, match=r"^task .*Drifts-v0: copy 1: .* gave 'holds' in an"):
        env.get_extra_state()
    env.copies.envs[1].unwrapped.holds = 0
    saved = env.get_extra_state()
    env.copies.envs[1].unwrapped.leaves_out = "holds"
    with pytest.raises(TaskFailedError, match=r"copy 1: .* gives 'holds' at some times only"):
        env.set_extra_state(saved)


def test_others_count_their_episodes_on():
    env = make("Clock", num_envs=2)
    assert not resumes_midway(env)
    env.reset()
    env.reset()
    expected = env.reset()["observation"]
    other = make("Clock", num_envs=2, seed=9)
    env.set_seed(0)
    env.reset()
    env.reset()
    other.set_extra_state(env.get_extra_state())
    assert torch.equal(other.reset()["observation"], expected)
    with pytest.raises(ValueError, match=r"holds 2 copies of .* there are 3: set env.num_envs=2"):
        make("Clock", num_envs=3).set_extra_state(env.get_extra_state())


def recorded(name, start, begin=0, steps=12):
    """An episode as gymnasium plays it from step ``begin`` on, and its start by ``start``."""
    env = gymnasium.make(name.partition(":")[2], disable_env_checker=True)
    env.action_space.seed(4)
    observation, _ = env.reset(seed=11)
    for _ in range(begin):
        observation, *_ = env.step(env.action_space.sample())
    values = start(env.unwrapped)
    observations, actions, rewards = [observation], [], []
    for _ in range(steps):
        action = env.action_space.sample()
        observation, reward, terminated, _, _ = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        assert not terminated
    env.close()
    demos = find_task(name).demos
    unit = to_unit(np.stack(actions), demos.action_low, demos.action_high).astype(np.float32)
    return Episode(
        np.stack(observations).astype(np.float32),
        unit,
        np.zeros(steps, np.float32),
        np.zeros(steps, np.bool_),
        Provenance("test", 0, "recorded"),
        values,
    ), np.array(rewards)


def positions(env):
    return {"qpos": env.data.qpos.copy(), "qvel": env.data.qvel.copy()}


def of_the_door(env):
    return {key: np.array(value, np.float64) for key, value in env.get_env_state().items()}


def seed(_):
    return {"start_seed": np.array([11.0])}


@pytest.mark.parametrize(
    ("name", "start", "begin"),
    [
        ("gymnasium:Reacher-v5", seed, 0),
        ("gymnasium:Pendulum-v1", seed, 0),
        ("gymnasium:HalfCheetah-v5", positions, 0),
        (DOOR, of_the_door, 0),
        (DOOR, seed, 0),
    ],
)
def test_recordings_are_replayed_from_their_starts(name, start, begin):
    episode, rewards = recorded(name, start, begin)
    (played,) = find_task(name).resimulate([episode])
    assert played.provenance.kind == "resimulated"
    assert played.length == episode.length
    np.testing.assert_allclose(played.observations, episode.observations, atol=2e-3)
    np.testing.assert_allclose(played.rewards, rewards, atol=2e-3)


def test_what_cannot_be_begun_again_stays_as_it_is(caplog):
    name = "gymnasium:Pendulum-v1"
    begun_midway, _ = recorded(name, seed, begin=5)
    unknown, _ = recorded(name, lambda _: {})
    with caplog.at_level(logging.WARNING, "envs.library"):
        kept = find_task(name).resimulate([begun_midway, unknown])
    assert kept[0] is begun_midway
    assert kept[1] is unknown
    assert "2 of 2 episodes are used as they were recorded, not played again" in caplog.text
    assert "Record them with their start_seed" in caplog.text
    assert "demos.resimulate=false" in caplog.text
