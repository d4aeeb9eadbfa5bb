"""Time limits, numbered starts, failures and the memory that copies take."""

from __future__ import annotations

import logging
import mmap

import psutil
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from envs import EnvOptions, find_task
from envs.library.memory import require_memory
from envs.options import TaskOptions
from envs.task import TaskFailedError
from pipeline.act.evaluation import Evaluator
from tests.envs.library.making import make, task

LIMITED = ("gymnasium:Pendulum-v1", "dm_control:reacher/easy")


def lengths(env, steps):
    done = env.rollout(steps, break_when_any_done=False)["next", "truncated"][0, :, 0]
    return (torch.nonzero(done).flatten() + 1).tolist()


@pytest.mark.parametrize("name", LIMITED)
@pytest.mark.parametrize("workers", [0])
def test_the_horizon_shortens(name, workers):
    env = find_task(name).make_env(EnvOptions(seed=0, horizon=4, workers=workers))
    assert lengths(env, 9) == [4, 8]
    env.close()


@pytest.mark.parametrize(("name", "own"), [(LIMITED[0], 200), (LIMITED[1], 1000)])
def test_the_horizon_extends(name, own):
    env = find_task(name).make_env(EnvOptions(seed=0, horizon=own + 3, workers=0))
    assert lengths(env, own + 4) == [own + 3]
    env.close()


def test_without_a_time_limit_a_horizon_is_needed():
    with pytest.raises(ValueError, match=r"Toys/Endless-v0 has no time limit .*env\.horizon=N"):
        make("Endless")
    assert lengths(make("Endless", horizon=3), 7) == [3, 6]


def test_an_environment_that_truncates_by_itself_needs_no_horizon(caplog):
    with caplog.at_level(logging.INFO, "envs.library"):
        env = make("EndsItself")
    assert lengths(env, 65) == [30, 60]
    assert "EndsItself-v0: episodes end after 30 steps by themselves" in caplog.text
    assert lengths(make("EndsItself", horizon=20), 45) == [20, 40]


def test_a_limit_may_take_most_of_the_search():
    """Of 2,000 steps; a second episode is not seen to its end."""
    assert lengths(make("EndsItself", TaskOptions(kwargs={"limits": [1900]})), 1901) == [1900]


@pytest.mark.parametrize("limits", [[0], [2001], [30, 50], [50, 30], [30, 0]])
def test_what_does_not_always_truncate_after_as_many_steps_needs_a_horizon(limits):
    """A truncation on leaving some bounds, say: other episodes may go on for ever."""
    with pytest.raises(ValueError, match=r"EndsItself-v0 has no time limit.*env\.horizon=N"):
        make("EndsItself", TaskOptions(kwargs={"limits": limits}))


def test_a_limit_inside_cannot_be_extended():
    assert lengths(make("Inner"), 4) == [4]
    assert lengths(make("Inner", horizon=3), 4) == [3]
    with pytest.raises(ValueError, match=r"env\.horizon=9: a limit inside of .* after 4 steps.*=4"):
        make("Inner", horizon=9)


def test_episodes_are_seeded_by_copy_and_number():
    """Copy 1's third episode is the same, whatever copy 0 does, and for any number of copies."""

    def begun(env, resets):
        td = env.reset()
        for mask in resets:
            td = env.reset(TensorDict({"_reset": torch.tensor(mask)[:, None]}, [len(mask)]))
        return td["observation"][1, 0].item(), env.copies.envs[1].unwrapped.np_random.integers(
            1 << 60
        )

    alone = begun(make("Clock", num_envs=2), [[False, True]] * 2)
    others = begun(
        make("Clock", num_envs=3), [[True, True, True], [True, False, True], [False, True, True]]
    )
    assert alone == others
    assert alone != begun(make("Clock", num_envs=2), [[False, True]])
    assert alone != begun(make("Clock", num_envs=2, seed=1), [[False, True]] * 2)


@pytest.mark.parametrize("kwargs", [{}, {"late": True}])
def test_an_evaluation_does_not_depend_on_its_batch(kwargs):
    """Episodes of 4 to 12 steps, of float64, with success from step 3 on."""
    policy = TensorDictModule(
        lambda seen: seen[..., :1] / 9 - seen[..., 1:2] / 20, ["observation"], ["action"]
    )
    found = [
        Evaluator(task("Clock", kwargs=kwargs), episodes=9, seed=3, batch=batch).run(policy)
        for batch in (1, 4, 9)
    ]
    assert len(set(found[0].lengths.tolist())) > 3
    assert (found[0].success.sum(1) == found[0].lengths - 2).all()
    for other in found[1:]:
        assert (other.returns == found[0].returns).all()
        assert (other.lengths == found[0].lengths).all()
        assert (other.success[:, : found[0].success.shape[1]] == found[0].success).all()
    other_list = Evaluator(task("Clock", kwargs=kwargs), episodes=9, seed=4, batch=9).run(policy)
    assert (other_list.lengths != found[0].lengths).any()


def test_an_evaluation_makes_few_copies_and_keeps_them(monkeypatch):
    made = []
    found = task("Clock")
    make_env = type(found.make_env).__call__

    def counted(self, options):
        made.append(options.num_envs)
        return make_env(self, options)

    monkeypatch.setattr(type(found.make_env), "__call__", counted)
    policy = TensorDictModule(lambda seen: seen[..., :1] * 0, ["observation"], ["action"])
    evaluator = Evaluator(found, episodes=20, seed=0, keep_env=True)
    first, second = evaluator.run(policy), evaluator.run(policy)
    assert made == [8]
    assert (first.lengths == second.lengths).all()
    env = evaluator._kept[0]
    evaluator.close()
    assert env.is_closed
    Evaluator(found, episodes=2, seed=0).run(policy)
    assert made == [8, 2]


@pytest.mark.parametrize(
    ("fails_in", "message"),
    [
        ("step", r"^task gymnasium:.*Clock-v0: copy 0 raised in step 6: KeyError: 'wheel'$"),
        ("reset", r"copy 0 raised in reset\(seed=\d+\): RuntimeError: the simulator is gone$"),
    ],
)
@pytest.mark.parametrize("workers", [0, 1])
def test_an_environment_that_raises_is_named_in_one_line(fails_in, message, workers):
    env = make("Clock", TaskOptions(kwargs={"fails_in": fails_in}), num_envs=2, workers=workers)
    with pytest.raises(TaskFailedError, match=message):
        env.rollout(40, break_when_any_done=False)
    env.close()


def test_an_environment_that_raises_when_it_is_tried():
    """The probe steps four times and the toy fails in its sixth step, but resets only once."""
    with pytest.raises(ValueError, match="never told"):
        task("Clock", success="info:nothing", kwargs={"late": True})
    with pytest.raises(TaskFailedError, match="raised when tried: KeyError: 'wheel'"):
        task("Clock", success="info:nothing", kwargs={"fails_in": "step"})


def test_copies_are_counted_against_the_free_memory(monkeypatch):
    """Each holds 20 MiB, 30 more are wanted, and 100 MiB are free."""
    made, block = [], b"x" * (1 << 20)

    def one():
        # Of the system itself, and nothing on the way: the allocator serves what it takes from what
        # earlier tests have freed, or keeps it.
        made.append(mmap.mmap(-1, 20 << 20))
        for _ in range(20):
            made[-1].write(block)
        return made[-1]

    free = psutil.virtual_memory()._replace(available=100 << 20)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: free)
    with pytest.raises(ValueError, match=r"32 copies of mine need \d{3} MiB, .* 100 MiB are free"):
        require_memory("mine", one, 32)
    assert len(made) == 2
    assert len(require_memory("mine", one, 4)) == 4
    with pytest.raises(ValueError, match="50 MiB are free"):
        require_memory("mine", one, 6, sharers=2)
