from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import check_env_specs

from envs import EnvOptions
from envs.adroit.simulator import HandSimulator
from envs.adroit.torchrl_env import HandEnv
from envs.door import task
from envs.door.definition import TASK
from envs.door.hand import DOOR, DOOR_POSITION
from tests.envs.door.conftest import door_position

FAR = torch.tensor([[-0.3, 1.6, 0.35]], dtype=torch.float64)
"""A place where the door is out of the hand's reach."""
KEYS = {"observation", "progress", "success", "done", "terminated", "truncated"}


def actions(steps: int, count: int, seed: int = 0) -> torch.Tensor:
    return torch.rand((steps, count, 28), generator=torch.manual_seed(seed)) * 2 - 1


def make(count: int = 1, **options) -> HandEnv:
    return TASK.make_env(EnvOptions(count, **options))


def positions(env: HandEnv) -> torch.Tensor:
    """Where the doors stand now, [N, 3], m."""
    return torch.as_tensor(env.simulator.placement[DOOR_POSITION])


def roll(env: HandEnv, given: torch.Tensor, td: TensorDict | None = None):
    """Step with automatic resets; returns the stacked steps [N, T] and the next root."""
    td = env.reset() if td is None else td
    steps = []
    for action in given:
        stepped, td = env.step_and_maybe_reset(td.set("action", action))
        steps.append(stepped.clone())
    return torch.stack(steps, 1), td


@pytest.mark.parametrize("count", [1, 3])
def test_specs(count):
    check_env_specs(make(count, seed=0))


@pytest.mark.parametrize("count", [1, 3])
def test_keys_shapes_and_types(count):
    env = make(count, seed=0)
    td = env.rand_step(env.reset())
    assert set(td.keys()) == KEYS | {"action", "next"}
    assert set(td["next"].keys()) == KEYS | {"reward"}
    assert td.batch_size == env.batch_size == (count,)
    for key, leaf in td["next"].items():
        assert leaf.shape == (count, 38 if key == "observation" else 1), key
        is_flag = key in {"success", "done", "terminated", "truncated"}
        assert leaf.dtype == (torch.bool if is_flag else torch.float32), key
    assert env.action_spec.space.low.unique() == -1
    assert env.action_spec.space.high.unique() == 1


def test_reward_flags_and_extras_are_the_task_functions_of_the_next_observation():
    steps, _ = roll(make(2, seed=0), actions(30, 2))
    following = steps["next", "observation"].numpy()
    for key, function in (
        ("reward", task.reward),
        ("progress", task.hinge_angle),
        ("success", task.success),
        ("terminated", task.terminated),
    ):
        expected = function(following)[..., None]
        np.testing.assert_array_equal(steps["next", key].numpy(), expected, err_msg=key)


def test_equals_the_simulator():
    env, given = make(2, seed=4), actions(20, 2)
    steps, _ = roll(env, given)
    with HandSimulator(DOOR, 2) as simulator:
        simulator.start({DOOR_POSITION: [door_position(4, i, 0) for i in range(2)]})
        expected = [simulator.step(action.numpy()) for action in given]
    np.testing.assert_array_equal(steps["next", "observation"].numpy(), np.stack(expected, 1))


def test_truncates_itself_at_the_horizon():
    assert make().horizon == 200
    steps, td = roll(make(2, horizon=5, seed=0), actions(11, 2))
    expected = torch.tensor([step % 5 == 4 for step in range(11)])
    for key in ("truncated", "done"):
        assert (steps["next", key].squeeze(-1) == expected).all()
    assert not steps["next", "terminated"].any()
    # The root after an automatic reset is the fresh one, and is not done.
    assert not steps["done"].any()
    assert not td["done"].any()


def test_terminates_when_the_hand_leaves_the_door():
    env = make(1, seed=0)
    td = env.reset(TensorDict(door_position=FAR, batch_size=[1]))
    # Out of reach already: the first step still happens, and ends the episode.
    assert not td["done"].any()
    following = env.step(td.set("action", actions(1, 1)[0]))["next"]
    assert following["terminated"].all()
    assert following["done"].all()
    assert not following["truncated"].any()


def test_partial_reset_touches_only_the_masked_doors():
    env = make(3, seed=0)
    _, td = roll(env, actions(4, 3))
    before, stood = td["observation"].clone(), positions(env)
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(td.clone().set("_reset", mask))
    changed = (after["observation"] != before).any(-1, keepdim=True)
    assert torch.equal(changed, mask)
    assert torch.equal((positions(env) != stood).any(-1, keepdim=True), mask)
    assert env.elapsed_steps.tolist() == [4, 0, 4]


def test_partial_step_touches_only_the_masked_doors():
    env = make(3, seed=0)
    td = env.reset()
    before, mask = td["observation"].clone(), torch.tensor([True, False, True])
    following = env.step(td.set("action", actions(1, 3)[0]).set("_step", mask))["next"]
    assert torch.equal((following["observation"] != before).any(-1), mask)
    assert torch.equal(following["reward"].squeeze(-1) != 0, mask)
    assert env.elapsed_steps.tolist() == [1, 0, 1]


def test_door_position_can_be_given_for_some_doors():
    env = make(2, seed=0)
    td = env.reset()
    drawn = positions(env)
    wanted = torch.tensor([[-0.21, 0.26, 0.27], [-0.22, 0.27, 0.28]], dtype=torch.float64)
    mask = torch.tensor([[False], [True]])
    env.reset(td.set("_reset", mask).set("door_position", wanted))
    assert torch.equal(positions(env), torch.stack([drawn[0], wanted[1]]))


def test_a_given_door_position_holds_for_one_episode():
    """The next episode's position is that of the second episode, however the first began."""
    env = make(1, horizon=3, seed=0)
    wanted = torch.tensor([[-0.21, 0.26, 0.27]], dtype=torch.float64)
    td = env.reset(TensorDict(door_position=wanted, batch_size=[1]))
    _, td = roll(env, actions(2, 1), td)
    assert torch.equal(positions(env), wanted)
    roll(env, actions(1, 1), td)
    np.testing.assert_array_equal(positions(env), [door_position(0, 0, 1)])


def positions_seen(env: HandEnv, resets: int) -> torch.Tensor:
    seen = []
    for _ in range(resets):
        env.reset()
        seen.append(positions(env))
    return torch.stack(seen)


def test_seeds():
    first = positions_seen(make(2, seed=1), 4)
    assert torch.equal(first, positions_seen(make(2, seed=1), 4))
    assert not torch.equal(first, positions_seen(make(2, seed=2), 4))
    assert len(torch.unique(first.reshape(-1, 3), dim=0)) == 8

    env = make(2, seed=2)
    positions_seen(env, 3)
    assert env.set_seed(1) != 1
    assert torch.equal(first, positions_seen(env, 4))


def test_without_a_seed_doors_differ_between_environments():
    assert not torch.equal(positions_seen(make(1), 1), positions_seen(make(1), 1))


def test_a_door_sees_the_same_positions_whoever_else_is_there():
    few, many = positions_seen(make(2, seed=3), 3), make(5, seed=3)
    td = many.reset()
    # The other doors reset more often; door 1 is reset with the first environment's.
    others = torch.tensor([[True], [False], [True], [True], [True]])
    seen = [positions(many)[1]]
    for _ in range(2):
        td = many.reset(td.set("_reset", others))
        td = many.reset(td.set("_reset", ~others))
        seen.append(positions(many)[1])
    assert torch.equal(torch.stack(seen), few[:, 1])


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_seeds_that_do_not_fit_are_refused(seed):
    with pytest.raises(ValueError, match="seed must be in"):
        make(1, seed=seed)


def test_horizon_must_be_positive():
    with pytest.raises(ValueError, match="horizon"):
        HandEnv(HandSimulator(DOOR), horizon=0)


def test_resumes_bit_for_bit_from_a_file(tmp_path):
    """In mid-episode, across later automatic resets, into an environment with another past."""
    env, before, after = make(2, horizon=7, seed=1), actions(10, 2, 1), actions(15, 2, 2)
    _, td = roll(env, before)
    torch.save({"env": env.state_dict(), "root": td.to_dict()}, tmp_path / "env.pt")
    expected, _ = roll(env, after, td.clone())
    expected_positions = positions(env)

    other = make(2, horizon=7, seed=9, num_threads=1)
    roll(other, after)
    saved = torch.load(tmp_path / "env.pt", weights_only=True)
    other.load_state_dict(saved["env"])
    resumed, _ = roll(other, after, TensorDict(saved["root"], batch_size=[2]))
    for key in ("observation", ("next", "observation"), ("next", "reward"), ("next", "done")):
        assert torch.equal(resumed[key], expected[key]), key
    assert torch.equal(positions(other), expected_positions)


def open_door(env: HandEnv, door: int) -> None:
    """Swings a door open, out of the hand's way, and leaves it there."""
    qpos = env.simulator.qpos[[door]]
    qpos[:, env.simulator.scene.model.joint("door_hinge").qposadr] = 1.5
    env.simulator.start({DOOR_POSITION: positions(env)[[door]]}, [door], qpos)


def truncated_after(env: HandEnv, steps: int) -> torch.Tensor:
    """What `truncated` is after each of some steps without a reset, [N, steps]."""
    td, still = TensorDict({}, env.batch_size), torch.zeros(env.num_copies, 28)
    td = td.set("action", still)
    return torch.cat([env.step(td)["next", "truncated"] for _ in range(steps)], -1)


def test_an_open_door_ends_its_episode():
    env = make(2, seed=0, success_steps=3)
    env.reset()
    assert not truncated_after(env, 4).any()
    open_door(env, 1)
    assert truncated_after(env, 4).tolist() == [[False] * 4, [False, False, True, True]]


def test_an_open_door_ends_no_episode_unless_asked():
    env = make(1, seed=0)
    env.reset()
    open_door(env, 0)
    assert not truncated_after(env, 10).any()


def test_steps_with_an_open_door_count_in_a_row_and_within_an_episode():
    env = make(1, seed=0, success_steps=3)
    env.reset()
    for _ in range(2):
        open_door(env, 0)
        assert not truncated_after(env, 2).any()
        env.simulator.start({DOOR_POSITION: positions(env)})  # closed again
        assert not truncated_after(env, 1).any()
    open_door(env, 0)
    truncated_after(env, 2)
    env.reset()
    open_door(env, 0)
    assert not truncated_after(env, 2).any()


def test_steps_with_an_open_door_are_saved():
    env, other = (make(1, seed=0, success_steps=3) for _ in range(2))
    env.reset()
    open_door(env, 0)
    truncated_after(env, 2)
    other.load_state_dict(env.state_dict())
    assert truncated_after(other, 1).all()
    # As states of before call them.
    state = env.get_extra_state()
    state["open"] = state.pop("success_streak")
    other.set_extra_state(state)
    assert truncated_after(other, 1).all()


def test_a_door_that_is_left_out_does_not_count_on():
    env = make(2, seed=0, success_steps=2)
    env.reset()
    for door in range(2):
        open_door(env, door)
    td = TensorDict({"action": torch.zeros(2, 28), "_step": torch.tensor([True, False])}, [2])
    for expected in ([[False], [False]], [[True], [False]]):
        assert env.step(td.clone())["next", "truncated"].tolist() == expected


def test_success_steps_below_one_are_refused():
    with pytest.raises(ValueError, match="success_steps must be at least 1 step"):
        HandEnv(HandSimulator(DOOR), success_steps=0)


def test_state_of_another_number_of_doors_is_refused():
    with pytest.raises(ValueError, match=r"holds 2 doors, and there are 1: set env.num_envs=2"):
        make(1).set_extra_state(make(2).get_extra_state())


def test_saved_state_does_not_change_with_the_environment():
    env = make(1, seed=0)
    roll(env, actions(2, 1))
    state = env.get_extra_state()
    copy = {key: value.clone() for key, value in state.items()}
    roll(env, actions(3, 1), env.reset())
    assert all(torch.equal(state[key], copy[key]) for key in copy)


def test_collector_with_several_doors():
    env = make(3, horizon=4, seed=0)
    collector = Collector(env, None, frames_per_batch=18, total_frames=36, set_truncated=False)
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    data = torch.cat(batches, 1)
    assert data.shape == (3, 12)
    ends = torch.tensor([step % 4 == 3 for step in range(12)])
    assert (data["next", "truncated"].squeeze(-1) == ends).all()
    # Within an episode the next observation is the following root; after an end it is not.
    same = (data["next", "observation"][:, :-1] == data["observation"][:, 1:]).all(-1)
    assert (same == ~ends[:-1]).all()


def test_rollout_breaks_and_continues_as_asked():
    env = make(2, horizon=3, seed=0)
    assert env.rollout(10).shape == (2, 3)
    assert env.rollout(10, break_when_any_done=False).shape == (2, 10)
