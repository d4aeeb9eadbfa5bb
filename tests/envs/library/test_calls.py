"""What an environment gives is held against gymnasium's API, and told in one line."""

from __future__ import annotations

import sys

import gymnasium
import pytest

from envs.library import calls
from envs.options import TaskOptions
from envs.task import TaskFailedError
from tests.envs.library.making import make, task
from tests.envs.library.toys import BOX, Otherwise

API = "gymnasium's API is expected: .*terminated, truncated, info .*shimmy"


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("reset", rf"reset\(\) returned one value \(ndarray\): {API}"),
        ("step", rf"step\(\) failed \(not enough values .*expected 5, got 4\)\): {API}"),
        ("close", r"the environment raised in close\(\): RuntimeError: the window is gone"),
        ("array", r"returned terminated=array\(\[False, .*expected True or False"),
        ("nan", r"returned terminated=nan, expected True or False"),
        ("none", r"returned terminated=None, expected True or False"),
    ],
)
def test_what_is_not_of_gymnasium_s_api_is_refused_in_one_line(what: str, message: str):
    with pytest.raises(TaskFailedError, match=rf"^task .*Toys/Otherwise-v0: .*{message}") as failed:
        task("Otherwise", kwargs={"what": what})
    assert "\n" not in str(failed.value)


def test_four_values_without_a_wrapper_of_gymnasium_are_counted():
    with pytest.raises(calls.OtherApiError, match=r"step\(\) returned 4 values \(ndarray, float,"):
        calls.step(Otherwise("step"), None)


def test_a_reset_that_takes_no_seed_is_of_the_old_gym():
    class Old(gymnasium.Env):
        observation_space = action_space = BOX

        def reset(self):
            return None

    with pytest.raises(calls.OtherApiError, match=f"unexpected keyword argument 'seed'.*{API}"):
        calls.reset(Old(), seed=0)


def test_an_end_that_becomes_nan_is_refused_with_copy_and_step():
    # With its success said, no episode is searched for it.
    options = TaskOptions(success="terminated", kwargs={"what": "nan", "since": 6})
    env = make("Otherwise", options)
    with pytest.raises(
        TaskFailedError, match=r"copy 0 in step 7: step\(\) returned terminated=nan"
    ):
        env.rollout(9)


def test_a_number_in_an_array_is_a_flag():
    assert make("Otherwise").rollout(3)["next", "terminated"].any().item() is False


def test_all_copies_are_closed_before_one_that_raises_is_told():
    env = make("Otherwise", num_envs=2)
    first, second = env.copies.envs
    first.unwrapped.what = "close"
    closed = []
    second.unwrapped.close = lambda: closed.append("second")
    with pytest.raises(TaskFailedError, match=r"copy 0 raised in close\(\): .*window is gone"):
        env.close()
    assert closed == ["second"]


def test_an_environment_that_ends_the_process_is_told_and_does_not():
    """With code 0 a run would end as one that is complete."""

    class Quits(gymnasium.Env):
        def step(self, action):
            sys.exit(0)

    with pytest.raises(RuntimeError, match=r"^sys\.exit\(0\) was called$"):
        calls.step(Quits(), None)
