from __future__ import annotations

import pytest
import torch
from torchrl.envs import check_env_specs

from envs import EnvOptions, find_task
from envs.flatten import UnsupportedSpaceError
from envs.library.actions import UnsupportedActionsError
from envs.options import TaskOptions
from tests.envs.library.making import make, task
from tests.envs.library.toys import HERE

# Name, keyword arguments, sizes of observation and action, own time limit.
TASKS = [
    ("gymnasium:Pendulum-v1", {}, 3, 1, 200),
    ("gymnasium:Hopper-v5", {}, 11, 3, 1000),
    ("dm_control:cheetah/run", {}, 17, 6, 1000),
    ("dm_control:reacher/easy", {}, 6, 2, 1000),
    (f"{HERE}/Spaces-v0", {"seen": "Goal"}, 6, 2, 5),
    (f"{HERE}/Spaces-v0", {"seen": "Discrete"}, 5, 2, 5),
    # 2 x 2 numbers, 2 numbers; 2 bits; one-hot of 2 and of 3.
    (f"{HERE}/Spaces-v0", {"seen": "Nested"}, 13, 2, 5),
    (f"{HERE}/Spaces-v0", {"seen": "Bytes"}, 3, 2, 5),
    (f"{HERE}/Spaces-v0", {"done": "Matrix"}, 2, 2, 5),
    (f"{HERE}/Spaces-v0", {"done": "Integer"}, 2, 1, 5),
]


@pytest.mark.parametrize(("name", "kwargs", "seen", "acted", "limit"), TASKS)
def test_every_environment_looks_alike(name, kwargs, seen, acted, limit):
    found = find_task(name, TaskOptions(kwargs=kwargs))
    env = found.make_env(EnvOptions(num_envs=2, seed=0, workers=0))
    check_env_specs(env)
    steps = env.rollout(3, break_when_any_done=False)
    assert steps["observation"].shape == (2, 3, seen)
    assert steps["action"].shape == (2, 3, acted)
    for key in ("observation", "action", ("next", "observation"), ("next", "reward")):
        assert steps[key].dtype == torch.float32, key
    assert (env.action_spec.space.low == -1).all()
    assert (env.action_spec.space.high == 1).all()
    assert (found.demos.observation_size, found.demos.action_size) == (seen, acted)
    assert found.demos.horizon == limit
    env.close()


def test_what_is_observed_is_the_flattened_observation():
    """Goal: achieved_goal, desired_goal, observation, as gymnasium's own sampling gives them."""
    from tests.envs.library.toys import OBSERVATIONS

    env = make("Spaces", TaskOptions(kwargs={"seen": "Goal"}))
    td = env.reset(env_start(7))
    space = OBSERVATIONS["Goal"]
    space.seed(7)
    sample = space.sample()
    keys = ("achieved_goal", "desired_goal", "observation")
    expected = [x for key in keys for x in sample[key].astype("float32").tolist()]
    assert td["observation"][0].tolist() == expected


def env_start(*seeds):
    from tensordict import TensorDict

    return TensorDict({"start_seed": torch.tensor(seeds)}, [len(seeds)])


def test_actions_arrive_in_the_environment_s_units():
    """Rows [-2, 2] and [0, 6]: the reward is the last entry; 0.5 is 4.5, and 3 is clipped to 6."""
    env = make("Spaces", TaskOptions(kwargs={"done": "Matrix"}), num_envs=3)
    td = env.reset().set("action", torch.tensor([[0.0, 0.5], [0.0, 3.0], [0.0, -1.0]]))
    assert env.step(td)["next", "reward"].flatten().tolist() == [4.5, 6.0, 0.0]


def test_integer_actions_are_rounded():
    """[0, 10]: 0.5 is 7.5, to the even 8; 0.13 is 5.65, to 6."""
    env = make("Spaces", TaskOptions(kwargs={"done": "Integer"}), num_envs=2)
    td = env.reset().set("action", torch.tensor([[0.5], [0.13]]))
    assert env.step(td)["next", "reward"].flatten().tolist() == [8.0, 6.0]


@pytest.mark.parametrize(
    ("done", "message"),
    [
        ("Infinite", r"Toys/Spaces-v0: the range of action entry \[1\] is infinite: \[-inf, inf\]"),
        ("Single", r"action entry \[1\] is a single number: \[3.0, 3.0\]"),
        ("Choices", r"its actions are Discrete\(4\)"),
    ],
)
def test_other_actions_are_refused(done, message):
    with pytest.raises(UnsupportedActionsError, match=message):
        task("Spaces", kwargs={"done": done})


@pytest.mark.parametrize(
    ("seen", "message"),
    [("Image", r"Toys/Spaces-v0: observation 'camera' is an image"), ("Text", "is a Text")],
)
def test_other_observations_are_refused(seen, message):
    with pytest.raises(UnsupportedSpaceError, match=message):
        task("Spaces", kwargs={"seen": seen})


def test_constructors_are_quiet(capsys, recwarn):
    make("Spaces", TaskOptions(kwargs={"seen": "Box", "done": "Integer"}), num_envs=2)
    assert capsys.readouterr().out == ""
    assert len(recwarn) == 0


def test_copies_left_out_of_a_step_or_a_reset_stay():
    env = make("Clock", num_envs=3)
    td = env.reset()
    td = env.step_mdp(env.step(td.set("action", torch.zeros(3, 1))))
    td = td.set("action", torch.ones(3, 1)).set("_step", torch.tensor([True, False, True]))
    after = env.step(td)["next"]
    # Times, and speeds: 1 is 3 of the environment's.
    assert after["observation"][:, 1].tolist() == [2, 1, 2]
    assert after["observation"][:, 2].tolist() == [3, 0, 3]
    reset = torch.tensor([[False], [False], [True]])
    begun = env.reset(
        after.select("observation", "done", "terminated", "truncated").set("_reset", reset)
    )
    assert begun["observation"][:, 1].tolist() == [2, 1, 0]


def test_wrappers_are_applied_in_order():
    """(x + 1) is doubled, or 2 x is raised: the start's time is 2 or 1."""
    module = "tests.envs.library.toys"
    both = (f"{module}:PlusOne", f"{module}:Doubled")
    for wrappers, expected in ((both, 2), (both[::-1], 1)):
        env = make("Clock", TaskOptions(wrappers=wrappers))
        assert env.reset()["observation"][0, 1].item() == expected


@pytest.mark.parametrize(
    ("wrapper", "message"),
    [
        ("nowhere", "task.wrappers: 'nowhere' is no import path; expected module:Class"),
        ("no_such_module:X", "task.wrappers: cannot import 'no_such_module'"),
        ("gymnasium.wrappers:Nope", "there is no 'Nope'; found: .*TimeLimit"),
        ("gymnasium.wrappers:TimeLimit", "TimeLimit cannot wrap gymnasium:.*max_episode_steps"),
    ],
)
def test_wrong_wrappers(wrapper, message):
    with pytest.raises(ValueError, match=message):
        task("Clock", wrappers=(wrapper,))


def test_keyword_arguments_reach_the_environment():
    env = make("Clock", TaskOptions(kwargs={"pay": 2.5}))
    assert env.rand_step(env.reset())["next", "reward"].item() == 2.5
    with pytest.raises(
        ValueError, match=r"cannot make .* with task.kwargs=\{'sped': 3\} \(TypeError"
    ):
        task("Clock", kwargs={"sped": 3})


def test_a_task_of_this_project_takes_no_options():
    with pytest.raises(
        ValueError, match=r"task\.success=terminated is for environments of gymnasium"
    ):
        find_task("door", TaskOptions(success="terminated"))
