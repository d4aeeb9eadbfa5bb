"""What any learner may expect of an environment; after dm_control's `suite_test.py`."""

from __future__ import annotations

import pytest
import torch

from tests.envs.making import make_env

HANDS = ["door", "hammer", "pen", "relocate"]
NAMES = [*HANDS, "gymnasium:AdroitDoor-v0", "gymnasium:Pendulum-v1", "dm_control:cartpole/swingup"]


@pytest.fixture(params=NAMES)
def env(request):
    made = make_env(request.param, num_envs=2, seed=0)
    yield made
    made.close()


def random_steps(env, count=30, seed=0):
    torch.manual_seed(seed)
    env.set_seed(seed)
    return env.rollout(count)


def test_everything_is_finite_and_within_its_spec(env):
    steps = random_steps(env)
    for step in range(steps.shape[1]):
        following = steps["next"][:, step]
        assert env.observation_spec["observation"].is_in(following["observation"])
        assert following["observation"].isfinite().all()
        assert following["reward"].isfinite().all()


def test_same_seed_same_actions_same_episode(env):
    one, other = random_steps(env), random_steps(env)
    assert torch.equal(one["next", "observation"], other["next", "observation"])
    assert torch.equal(one["next", "reward"], other["next", "reward"])


def test_initial_state_varies(env):
    starts = torch.stack([env.reset()["observation"] for _ in range(3)])
    assert len(torch.unique(starts.reshape(-1, starts.shape[-1]), dim=0)) == 6


def test_steps_share_no_memory(env):
    td = env.reset()
    stepped = env.rand_step(td)
    kept = stepped["next", "observation"]
    copy = kept.clone()
    env.rand_step(env.step_mdp(stepped))
    assert torch.equal(kept, copy)


#: What a random hand seldom touches: the latch of a door; a nail, its head's place and its force.
UNTOUCHED = {"door": {27}, "gymnasium:AdroitDoor-v0": {27}, "hammer": {26, 42, 43, 45}}


def test_no_observation_entry_is_constant(env, request):
    steps = random_steps(env, 60)
    constant = (steps["next", "observation"].flatten(0, 1).std(0) == 0).nonzero().flatten()
    name = request.node.callspec.params["env"]
    assert set(constant.tolist()) <= UNTOUCHED.get(name, set())


def test_the_action_matters(env):
    env.set_seed(0)
    low = env.step(env.reset().set("action", torch.full_like(env.action_spec.zero(), -1)))
    env.set_seed(0)
    high = env.step(env.reset().set("action", torch.full_like(env.action_spec.zero(), 1)))
    assert (low["next", "observation"] != high["next", "observation"]).any(-1).all()
