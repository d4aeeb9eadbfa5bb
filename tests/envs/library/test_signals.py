from __future__ import annotations

import logging
from contextlib import suppress

import numpy as np
import pytest
import torch
from gymnasium.envs.classic_control.pendulum import PendulumEnv

from envs.demonstrations import DemoOptions, load_demonstrations
from envs.library.probe import probe
from envs.library.single import SingleEnv
from envs.options import TaskOptions
from tests.envs.library.making import make, task


def told(column, steps, **options):
    """A column of one episode of zero actions, from the reset on."""
    env = make("Clock", TaskOptions(**options))
    td = env.reset()
    seen = [td[column].item()]
    for _ in range(steps):
        td = env.step(td.set("action", torch.full((1, 1), 0.5)))["next"]
        seen.append(td[column].item())
    env.close()
    return seen


# The clock tells success from step 3 on, ends in step 4 at the earliest, pays -1, speed is 1.5.
FROM_3 = [False, False, False, True, True]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, FROM_3),
        ({"kwargs": {"told": "success"}}, FROM_3),
        ({"success": "info:is_success"}, FROM_3),
        ({"success": "info:done", "kwargs": {"told": "done", "late": True}}, FROM_3),
        ({"success": "reward>=-1"}, [False, True, True, True, True]),
        ({"success": "reward >= -0.5"}, [False] * 5),
        ({"success": "return>=6", "kwargs": {"pay": 2.0}}, FROM_3),
        ({"success": "return>=-2.5"}, [False, True, True, False, False]),
    ],
)
def test_success(options, expected):
    assert told("success", 4, **options) == expected


@pytest.mark.parametrize("options", [{}, {"success": "info:is_success"}, {"progress": "info:time"}])
@pytest.mark.parametrize("name", ["EndsItself", "EndsLater"])
def test_success_that_is_told_only_in_the_last_step_is_false_before(name, options):
    env = make(name, TaskOptions(**options), num_envs=8)
    steps = env.rollout(30, break_when_any_done=False)
    assert not steps["success"].any()
    assert not steps["next", "success"][:, :29].any()
    good = [copy.unwrapped.good for copy in env.copies.envs]
    assert steps["next", "success"][:, 29, 0].tolist() == good
    assert 0 < sum(good) < 8


def test_success_that_no_random_action_brings_about_can_be_named(caplog):
    """Many an environment tells it only in the step that succeeds; here, after the search."""
    options = {"kwargs": {"limits": [3000]}}
    with caplog.at_level(logging.WARNING, "envs.library"):
        env = make("EndsLater", TaskOptions(success="info:is_success", **options))
    assert "told no 'is_success' in an episode of random actions" in caplog.text
    assert not env.rollout(40)["next", "success"].any()
    assert "success" not in make("EndsLater", TaskOptions(**options)).observation_spec.keys()  # noqa: SIM118 - a spec is not a mapping


@pytest.mark.parametrize(("options", "least"), [({}, 0), ({"success": "info:nothing"}, 200)])
def test_gymnasium_s_own_environments_are_searched_only_on_request(monkeypatch, options, least):
    step, taken = PendulumEnv.step, []
    monkeypatch.setattr(PendulumEnv, "step", lambda *of: taken.append(0) or step(*of))
    with suppress(ValueError):
        probe(SingleEnv("gymnasium", "Pendulum-v1", TaskOptions(**options)))
    assert least <= len(taken) < least + 100  # of the 200 of an episode


def test_success_by_termination():
    env = make("Clock", TaskOptions(success="terminated"), num_envs=2)
    steps = env.rollout(12, break_when_any_done=False)
    assert steps["next", "terminated"].any()
    assert torch.equal(steps["next", "success"], steps["next", "terminated"])
    assert not steps["success"][:, 0].any()


def test_progress_by_info():
    assert told("progress", 3, progress="info:depth") == pytest.approx([0.0, 0.1, 0.2, 0.3])


FUNCTIONS = """
def late(observation):
    return observation[:, 1] >= 2

def share(observation):
    return observation[:, 1] / 10

def pay(observation, action, next_observation):
    return 100 * observation[:, 1] + 10 * action[:, 0] + next_observation[:, 1]

def one(observation):
    return 1.0
"""


@pytest.fixture
def functions(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(FUNCTIONS)
    return file


def test_functions_of_a_file(functions):
    """Times 0 to 3; the reward of step t is 100 (t - 1) + 10 * 0.5 + t."""
    options = {
        "success": f"{functions}:late",
        "progress": f"{functions}:share",
        "reward": f"{functions}:pay",
    }
    assert told("success", 3, **options) == [False, False, True, True]
    assert told("progress", 3, **options) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    env = make("Clock", TaskOptions(**options), num_envs=2)
    td = env.reset()
    rewards = []
    for _ in range(3):
        td = env.step(td.set("action", torch.full((2, 1), 0.5)))["next"]
        rewards.append(td["reward"].flatten().tolist())
    assert rewards == [[6.0, 6.0], [107.0, 107.0], [208.0, 208.0]]
    schema = task("Clock", **options).demos
    rows = torch.tensor([[5.0, 1.0, 0.0], [5.0, 2.0, 0.0]]).numpy()
    assert schema.success(rows).tolist() == [False, True]
    assert schema.progress(rows).tolist() == pytest.approx([0.1, 0.2])
    assert schema.step_reward(rows[:1], rows[:1, :1] * 0, rows[1:]).tolist() == [102.0]


@pytest.mark.parametrize("resimulate", [True, False])
@pytest.mark.parametrize("recorded", [None, 7.0])
def test_recordings_that_cannot_be_replayed_are_paid_by_the_function_too(
    functions, tmp_path, recorded, resimulate
):
    """Times 0 to 3 and actions of 1.5, which are 0.5 of policies; no seed says where they begin."""
    file = tmp_path / "d.npz"
    seen = np.stack([np.full(4, 5.0), np.arange(4.0), np.zeros(4)], axis=-1)
    arrays = {"observations": seen, "actions": np.full((3, 1), 1.5)}
    if recorded is not None:
        arrays["rewards"] = np.full(3, recorded)
    np.savez(file, **arrays)
    found = task("Clock", reward=f"{functions}:pay")
    loaded = load_demonstrations(file, found, DemoOptions(resimulate=resimulate))
    assert loaded.episodes[0].provenance.kind == "recorded"
    assert loaded.episodes[0].rewards.tolist() == [6.0, 107.0, 208.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"success": "often"}, "task.success must be one of info:KEY, terminated,.*got 'often'"),
        ({"success": "reward>=much"}, "task.success=reward>=much: 'much' is not a number"),
        ({"success": "nowhere.py:f"}, "task.success=nowhere.py:f: there is no file 'nowhere.py'"),
        ({"success": "MINE:nope"}, "there is no 'nope'; found: late, one, pay, share"),
        ({"progress": "MINE:one"}, r"task.progress=.*:one gave an array of shape \[\] for 2 rows"),
        ({"progress": "speed"}, "task.progress must be one of info:KEY, path.py:function"),
        (
            {"success": "info:wun"},
            "never told 'wun' in a whole episode; its info holds depth, is_su",
        ),
        ({"reward": "pay"}, "task.reward must be one of path.py:function, got 'pay'"),
    ],
)
def test_wrong_options(options, message, functions):
    options = {key: value.replace("MINE", str(functions)) for key, value in options.items()}
    with pytest.raises(ValueError, match=message):
        make("Clock", TaskOptions(**options), num_envs=2).reset()


def test_episodes_that_succeed_end_early():
    """Success in steps 3 and 4, so the second in a row is step 4; a start of 9 would end in 12."""
    env = make("Clock", num_envs=6, success_steps=2)
    steps = env.rollout(5, break_when_any_done=False)
    truncated = steps["next", "truncated"][..., 0]
    terminated = steps["next", "terminated"][..., 0]
    assert truncated[:, 3].all()
    assert not truncated[:, :3].any()
    assert not terminated.all()


def test_success_steps_need_success():
    with pytest.raises(
        ValueError, match=r"env.success_steps=2 .* tells no success: say what it is"
    ):
        make("Clock", TaskOptions(kwargs={"told": "other"}), success_steps=2)


def test_a_task_without_success_says_so(caplog):
    with caplog.at_level(logging.WARNING, "envs.library"):
        env = make("Clock", TaskOptions(kwargs={"told": "another"}))
    assert "tells no success" in caplog.text
    assert "success" not in env.observation_spec.keys()  # noqa: SIM118 - a spec is not a mapping
