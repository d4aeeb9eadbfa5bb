from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torchrl.envs import check_env_specs

from envs.adroit.simulator import HandSimulator
from envs.adroit.torchrl_env import HandEnv
from envs.door.hand import DOOR
from envs.registry import OURS, UnknownTaskError, find_task, reference_of
from tests.envs.making import make_env

pytestmark = pytest.mark.filterwarnings("ignore:.*settotalmass")

# Name, observation and action sizes as published, own time limit in steps.
TASKS = [
    ("door", 38, 28, 200),
    ("hammer", 46, 26, 200),
    ("pen", 45, 24, 100),
    ("relocate", 39, 30, 200),
    ("gymnasium:Pendulum-v1", 3, 1, 200),
    ("dm_control:cartpole/swingup", 5, 1, 1000),
    ("dm_control:walker/walk", 24, 6, 1000),
    ("dm_control:cheetah/run", 17, 6, 1000),
]
LIMITED = ["gymnasium:Pendulum-v1", "dm_control:cartpole/swingup", "door", "hammer", "pen"]
LIMITED += ["relocate"]


@pytest.mark.parametrize("name", [*OURS, "gymnasium:Pendulum-v1"])
def test_published_rows_are_the_task_s(name):
    assert reference_of(name) is find_task(name).reference


@pytest.mark.parametrize(("name", "observed", "acted", "_limit"), TASKS)
def test_the_common_contract(name, observed, acted, _limit):
    env = make_env(name, num_envs=2, seed=0)
    check_env_specs(env)
    steps = env.rollout(3)
    assert env.batch_size == (2,)
    assert steps["observation"].shape == (2, 3, observed)
    assert steps["action"].shape == (2, 3, acted)
    assert steps["next", "reward"].shape == (2, 3, 1)
    for key in ("observation", "action", ("next", "observation"), ("next", "reward")):
        assert steps[key].dtype == torch.float32, key
    assert (env.action_spec.space.low == -1).all()
    assert (env.action_spec.space.high == 1).all()
    env.close()


@pytest.mark.parametrize("name", LIMITED)
def test_seeds(name):
    def start(seed):
        env = make_env(name, num_envs=2, seed=seed)
        observation = env.reset()["observation"]
        env.close()
        return observation

    assert torch.equal(start(1), start(1))
    assert not torch.equal(start(1), start(2))
    assert not torch.equal(*start(1))


@pytest.mark.parametrize("name", LIMITED)
def test_time_limits_truncate(name):
    env = make_env(name, seed=0)
    limit = next(task[3] for task in TASKS if task[0] == name)
    steps = env.rollout(limit + 1)
    assert steps.shape == (1, limit)
    assert steps["next", "truncated"][:, -1].all()
    assert not steps["next", "terminated"].any()
    env.close()


@pytest.mark.parametrize("name", LIMITED)
def test_horizon_shortens(name):
    env = make_env(name, num_envs=2, seed=0, horizon=4)
    truncated = env.rollout(9, break_when_any_done=False)["next", "truncated"].squeeze(-1)
    assert torch.equal(truncated, torch.tensor([[i % 4 == 3 for i in range(9)]] * 2))
    env.close()


def test_actions_are_rescaled_to_the_task_s_own_bounds():
    """Pendulum's torque limit is 2: action 0.5 is torque 1, its reward costs 0.001 * 1^2."""
    env = make_env("gymnasium:Pendulum-v1", seed=0)
    td = env.reset()
    cos, sin, speed = td["observation"][0].tolist()
    angle = torch.atan2(torch.tensor(sin), torch.tensor(cos)).item()
    reward = env.step(td.set("action", torch.full((1, 1), 0.5)))["next", "reward"].item()
    assert reward == pytest.approx(-(angle**2 + 0.1 * speed**2 + 0.001), abs=1e-5)
    env.close()


def test_the_door_gets_its_options():
    env = make_env("door", num_envs=2, seed=5, num_threads=1, horizon=7, success_steps=4)
    assert isinstance(env, HandEnv)
    assert (env.horizon, env.simulator.num_threads, env.num_copies) == (7, 1, 2)
    assert env.success_steps == 4
    env.reset()
    other = HandEnv(HandSimulator(DOOR, 2), seed=5)
    other.reset()
    stand, others = (one.simulator.placement["door_position"] for one in (env, other))
    assert stand.tolist() == others.tolist()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "dor",
            r"unknown task 'dor'; valid: door, .*pen, .*gymnasium:ID .*dm_control:DOMAIN/TASK",
        ),
        ("gym:Pendulum-v1", "unknown task"),
        ("gymnasium:Nope-v9", "cannot make environment 'gymnasium:Nope-v9'.*doesn't exist"),
        ("dm_control:walker", r"cannot make.*expected DOMAIN/TASK"),
        ("dm_control:walker/fly", "cannot make"),
    ],
)
def test_unknown_names(name, message):
    with pytest.raises(UnknownTaskError, match=message):
        make_env(name)


@pytest.mark.parametrize("option", ["num_envs", "horizon"])
def test_counts_must_be_positive(option):
    with pytest.raises(ValueError, match=option):
        make_env("gymnasium:Pendulum-v1", **{option: 0})


def test_success_steps_need_success():
    with pytest.raises(
        ValueError, match=r"success_steps=4.*tells no success.*env\.success_steps=null"
    ):
        make_env("gymnasium:Pendulum-v1", success_steps=4)


def test_discrete_actions_are_refused():
    with pytest.raises(
        ValueError, match=r"actions are Discrete\(2\), and policies here take finite boxes"
    ):
        make_env("gymnasium:CartPole-v1")


class ImageToy(gymnasium.Env):
    """Two observations of different rank; the reward is the second action as the task gets it."""

    observation_space = spaces.Dict(
        {"image": spaces.Box(0, 1, (2, 3), float), "speed": spaces.Box(-1, 1, (1,), float)}
    )
    action_space = spaces.Box(-2, 6, (2,), float)

    def __init__(self):
        """Without one, torchrl's probing for `frameskip` fails in another way."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), float(action[1]), False, False, {}


@pytest.fixture
def image_toy():
    gymnasium.register("ImageToy-v0", entry_point=ImageToy, disable_env_checker=True)
    yield
    gymnasium.registry.pop("ImageToy-v0")


@pytest.mark.usefixtures("image_toy")
def test_dictionary_observations_are_flattened():
    env = make_env("gymnasium:ImageToy-v0", num_envs=2, horizon=5)
    td = env.reset()
    assert set(td.keys()) & {"image", "speed"} == set()
    assert td["observation"].shape == (2, 7)
    reward = env.step(td.set("action", torch.tensor([[0.0, 1.0], [0.0, -1.0]])))["next", "reward"]
    # The task's bounds are -2 and 6.
    assert reward.flatten().tolist() == [6, -2]


class Counter(gymnasium.Env):
    """Steps so far, in float64; the n-th copy that is made ends after 2 n steps."""

    observation_space = spaces.Box(-100, 100, (1,), np.float64)
    action_space = spaces.Box(-1, 1, (1,), np.float64)
    made = 0

    def __init__(self):
        """Longer than the copies before it."""
        type(self).made += 1
        self.limit = 2 * self.made

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1), {}

    def step(self, action):
        self.steps += 1
        assert self.steps <= self.limit, "stepped on after its end"
        return np.full(1, float(self.steps)), 1.0, self.steps == self.limit, False, {}


@pytest.fixture
def counter():
    gymnasium.register(
        "Counter-v0", entry_point=Counter, disable_env_checker=True, max_episode_steps=99
    )
    yield
    gymnasium.registry.pop("Counter-v0")


@pytest.mark.usefixtures("counter")
@pytest.mark.parametrize("horizon", [None, 5])
def test_copies_of_float64_tasks_may_end_at_different_times(horizon):
    """A copy that has ended is left alone, and the others see nothing of it."""
    env = make_env("gymnasium:Counter-v0", num_envs=3, horizon=horizon)
    td = env.reset()
    limits = [2 * (Counter.made - 2 + copy) for copy in range(3)]  # of the last three made
    active, seen = torch.ones(3, dtype=torch.bool), [[], [], []]
    while active.any():
        td = env.step(td.set("action", torch.zeros(3, 1)))
        assert td["next", "observation"].dtype == td["next", "reward"].dtype == torch.float32
        for copy in active.nonzero().flatten().tolist():
            seen[copy].append(td["next", "observation"][copy].item())
        active = active & ~td["next", "done"].squeeze(-1)
        td = env.step_mdp(td).set("_step", active)
    env.close()
    lengths = [limit if horizon is None else min(limit, horizon) for limit in limits]
    assert seen == [[float(t + 1) for t in range(length)] for length in lengths]
