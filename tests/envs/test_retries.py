"""Doors that were not opened come back, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from envs import make_env
from envs.door.retries import WAITING_DOORS, FailedDoors
from envs.door.starts import door_position
from envs.door.torchrl_env import DoorEnv
from tests.envs.conftest import PROPERTY

HORIZON = 3


def episode(env: DoorEnv, td: TensorDict) -> TensorDict:
    """Acts with zeros until the doors have been reset; returns the next root."""
    for _ in range(HORIZON):
        td = env.step_and_maybe_reset(td.set("action", torch.zeros(env.num_doors, 28)))[1]
    return td


def put_hinge(env: DoorEnv, angle: float, *doors: int) -> None:
    """Puts the hinges of `doors` at `angle` (rad), where the next step finds them."""
    qpos = np.zeros((len(doors), 30))
    qpos[:, env.simulator.scene.hinge_qpos] = angle
    env.simulator.reset(env.simulator.door_position[list(doors)], list(doors), qpos)


def fresh(env_seed: int, number: int, doors: int) -> np.ndarray:
    return np.array([door_position(env_seed, door, number) for door in range(doors)])


def test_the_door_that_waits_longest_comes_first_and_as_often_as_asked():
    failed = FailedDoors(repeats=2)
    failed.add(np.array([[1.0, 0, 0], [2.0, 0, 0]]))
    failed.add(np.array([[3.0, 0, 0]]))
    assert [failed.take()[0] for _ in range(6)] == [1, 1, 2, 2, 3, 3]
    assert len(failed) == 0


def test_without_repeats_nothing_waits():
    failed = FailedDoors()
    failed.add(np.ones((5, 3)))
    assert len(failed) == 0


def test_a_negative_number_is_refused():
    with pytest.raises(ValueError, match="retry_failed must not be negative, got -1"):
        DoorEnv(1, retry_failed=-1)


@PROPERTY
@given(st.lists(st.integers(0, 60), max_size=6), st.integers(1, 4))
def test_the_newest_stay_when_more_wait_than_there_is_room_for(counts, repeats):
    failed, everything = FailedDoors(repeats), []
    for count in counts:
        numbers = np.arange(count) + 1000.0 * len(everything)
        failed.add(np.stack([numbers] * 3, 1))
        everything += [number for number in numbers for _ in range(repeats)]
    assert failed.get_state()[:, 0].tolist() == everything[-WAITING_DOORS:]


def test_every_second_episode_starts_where_one_failed():
    env = DoorEnv(2, horizon=HORIZON, seed=5, retry_failed=2)
    td = env.reset()
    first = fresh(5, 0, 2)
    td = episode(env, td)
    np.testing.assert_array_equal(env.door_position, first[[0, 0]])
    td = episode(env, td)
    np.testing.assert_array_equal(env.door_position, fresh(5, 2, 2))
    episode(env, td)
    np.testing.assert_array_equal(env.door_position, first[[1, 1]])


def test_an_opened_door_does_not_come_back():
    env = DoorEnv(2, horizon=HORIZON, seed=5, retry_failed=1)
    td = env.reset()
    put_hinge(env, 1.4, 0)
    episode(env, td)
    np.testing.assert_array_equal(
        env.door_position, [door_position(5, 1, 0), door_position(5, 1, 1)]
    )


def test_opened_is_about_the_episode_and_not_about_its_end():
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=1)
    td = env.reset()
    put_hinge(env, 1.4, 0)
    td = env.step_and_maybe_reset(td.set("action", torch.zeros(1, 28)))[1]
    put_hinge(env, 0.0, 0)
    for _ in range(HORIZON - 1):
        td = env.step_and_maybe_reset(td.set("action", torch.zeros(1, 28)))[1]
    np.testing.assert_array_equal(env.door_position, fresh(5, 1, 1))


def test_the_next_episode_is_judged_anew():
    """The first opens, the second does not: the third may not take the first for its own."""
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=1)
    td = env.reset()
    put_hinge(env, 1.4, 0)
    td = episode(env, episode(env, td))
    episode(env, td)
    np.testing.assert_array_equal(env.door_position, fresh(5, 1, 1))


def test_a_hand_that_leaves_the_door_has_failed():
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=1)
    far = torch.tensor([[-0.3, 1.6, 0.35]], dtype=torch.float64)
    td = env.reset(TensorDict({"door_position": far}, batch_size=[1]))
    env.step_and_maybe_reset(td.set("action", torch.zeros(1, 28)))
    np.testing.assert_array_equal(env.door_position, far)


def test_an_episode_that_was_cut_short_says_nothing():
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=1)
    env.step(env.reset().set("action", torch.zeros(1, 28)))
    env.reset()
    np.testing.assert_array_equal(env.door_position, fresh(5, 1, 1))


def test_a_door_out_of_reach_has_not_failed_before_its_first_step():
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=1)
    env.reset(TensorDict({"door_position": [[-0.3, 1.6, 0.35]]}, batch_size=[1]))
    env.reset()
    np.testing.assert_array_equal(env.door_position, fresh(5, 1, 1))


def test_a_new_seed_forgets_the_doors_that_wait():
    env = DoorEnv(1, horizon=HORIZON, seed=5, retry_failed=3)
    episode(env, env.reset())
    env.set_seed(6)
    env.reset()
    env.reset()
    np.testing.assert_array_equal(env.door_position, fresh(env._seed, 1, 1))


def test_the_doors_that_wait_are_part_of_the_saved_state():
    env, other = (DoorEnv(2, horizon=HORIZON, seed=s, retry_failed=3) for s in (5, 9))
    td = episode(env, env.reset())
    put_hinge(env, 1.4, 1)
    td = env.step_and_maybe_reset(td.set("action", torch.zeros(2, 28)))[1]
    put_hinge(env, 0.0, 1)  # that it was open is known from before only
    other.load_state_dict(env.state_dict())
    for _ in range(12):
        td, again = episode(env, td.clone()), episode(other, td.clone())
        assert torch.equal(env.door_position, other.door_position)
        assert torch.equal(td["observation"], again["observation"])


def test_the_factory_passes_it_on_and_refuses_it_elsewhere():
    assert make_env("door", retry_failed=2, seed=0).retry_failed == 2
    with pytest.raises(ValueError, match=r"retry_failed=2 is for the door, not for 'gymnasium:P"):
        make_env("gymnasium:Pendulum-v1", retry_failed=2)
