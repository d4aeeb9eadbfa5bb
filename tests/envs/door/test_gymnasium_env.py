from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import envs
from envs.adroit.simulator import HandSimulator
from envs.door import hand, task
from envs.door.gymnasium_env import AdroitDoorEnv

DOOR = [-0.25, 0.3, 0.3]


@pytest.fixture
def env():
    made = gymnasium.make("AdroitDoor-v0")
    yield made
    made.close()


# Joint angles and positions have no bounds of their own; gymnasium prefers some.
@pytest.mark.filterwarnings("ignore:.*A Box observation space (minimum|maximum) value is")
def test_gymnasium_checker(env):
    check_env(env.unwrapped, skip_render_check=True)


def test_spaces(env):
    assert envs.GYMNASIUM_ID in gymnasium.registry
    assert env.observation_space.shape == (38,)
    assert env.observation_space.dtype == np.float32
    np.testing.assert_array_equal(env.action_space.low, -np.ones(28))
    np.testing.assert_array_equal(env.action_space.high, np.ones(28))


def test_truncates_at_200(env):
    env.reset(seed=0)
    flags = [env.step(np.zeros(28, np.float32))[2:4] for _ in range(200)]
    assert flags == [(False, False)] * 199 + [(False, True)]


def test_equals_the_simulator(env, rng):
    observation, info = env.reset(options={"door_position": DOOR})
    with HandSimulator(hand.DOOR, 1) as simulator:
        np.testing.assert_array_equal(observation, simulator.start({"door_position": [DOOR]})[0])
        np.testing.assert_array_equal(info["door_position"], DOOR)
        for action in rng.uniform(-1, 1, (20, 28)).astype(np.float32):
            expected = simulator.step(action[None])[0]
            observation, reward, terminated, _, info = env.step(action)
            np.testing.assert_array_equal(observation, expected)
            assert reward == task.reward(expected)
            assert terminated == task.terminated(expected)
            assert info["success"] is False
            assert info["hinge_angle"] == expected[28]


def test_terminates_out_of_reach(env):
    env.reset(options={"door_position": [-0.3, 1.6, 0.35]})
    assert env.step(-np.ones(28, np.float32))[2] is True


def test_success_is_reported(env):
    env.reset(options={"door_position": DOOR})
    qpos = np.zeros((1, 30))
    qpos[0, 28] = 1.5
    env.unwrapped._simulator.start({"door_position": [DOOR]}, qpos=qpos)
    *_, info = env.step(np.zeros(28, np.float32))
    assert info["success"] is True
    assert info["hinge_angle"] == pytest.approx(1.5, abs=0.05)


def test_seeded_door_positions(env):
    def seen(seed):
        return [env.reset(seed=seed)[1]["door_position"], env.reset()[1]["door_position"]]

    first = seen(1)
    np.testing.assert_array_equal(first, seen(1))
    assert not np.array_equal(first, seen(2))
    assert not np.array_equal(*first)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"door_pos": DOOR}, r"unknown reset options \['door_pos'\]; known: \['door_position'\]"),
        ({"door_position": [0.0, 1.0]}, "door_position must have shape"),
        ({"door_position": [0.0, 1.0, np.nan]}, "door_position holds NaN"),
    ],
)
def test_bad_options(env, options, message):
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_unknown_render_mode():
    with pytest.raises(ValueError, match="'human'"):
        AdroitDoorEnv(render_mode="human")


def test_render_without_a_mode_is_none():
    env = AdroitDoorEnv()
    env.reset(seed=0)
    assert env.render() is None
