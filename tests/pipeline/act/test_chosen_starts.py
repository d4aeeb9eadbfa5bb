"""Episodes that begin where they are told to, and say so."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs

from envs import EnvOptions
from pipeline.act.chosen_starts import ChosenStartsEnv
from pipeline.files.checkpoint import resumes_midway
from tests.toys import reach

STILL = torch.zeros(3, 2)


class Counting:
    """Begins at points 10, 11, ... of demonstrations 0, 1, ..., step 5."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, count: int) -> tuple[TensorDict, torch.Tensor]:
        numbers = torch.arange(self.count, self.count + count)
        self.count += count
        starts = (10.0 + numbers)[:, None].expand(count, 4)
        at = torch.stack([numbers, torch.full_like(numbers, 5)], dim=-1)
        return TensorDict({"start": starts}, [count]), at


def made(begin=None, horizon: int = 4) -> ChosenStartsEnv:
    return ChosenStartsEnv(reach.Reach(EnvOptions(num_envs=3, seed=1, horizon=horizon)), begin)


def test_it_is_an_environment():
    check_env_specs(made())
    check_env_specs(made(Counting()))


def test_without_being_told_it_is_what_it_wraps():
    plain = reach.Reach(EnvOptions(num_envs=3, seed=1))
    begun = made()
    expected, found = plain.reset(), begun.reset()
    assert torch.equal(found["observation"], expected["observation"])
    assert found["is_init"].all()
    assert (found["begun_at"] == -1).all()
    after = begun.step(found.set("action", STILL))["next"]
    assert not after["is_init"].any()


def test_copies_begin_where_they_are_told_and_only_those_that_begin():
    env = made(Counting())
    td = env.reset()
    assert td["observation"][:, 0].tolist() == [10, 11, 12]
    assert td["begun_at"].tolist() == [[0, 5], [1, 5], [2, 5]]
    td = env.step_mdp(env.step(td.set("action", STILL)))
    only = torch.tensor([False, True, False])[:, None]
    td = env.reset(td.set("_reset", only))
    assert td["observation"][:, 0].tolist() == [10, 13, 12]
    assert td["begun_at"].tolist() == [[0, 5], [3, 5], [2, 5]]
    assert td["is_init"].squeeze(-1).tolist() == [False, True, False]


def test_automatic_resets_are_told_too():
    """Two steps an episode: the third step is the first of the next."""
    env = made(Counting(), horizon=2)
    td = env.reset()
    seen = []
    for _ in range(3):
        step, td = env.step_and_maybe_reset(td.set("action", STILL))
        seen.append(step["begun_at"][:, 0].tolist())
    assert seen == [[0, 1, 2], [0, 1, 2], [3, 4, 5]]


def test_where_nobody_tells_any_more_episodes_are_the_tasks_own():
    told = [Counting()(3)]
    env = made(lambda _: told.pop() if told else None)
    assert (env.reset()["begun_at"][:, 1] == 5).all()
    own = env.reset()
    assert (own["begun_at"] == -1).all()
    assert own["observation"].abs().max() <= 1.0, "not the points 10, 11 and 12"


def test_it_is_resumed_with_what_it_wraps():
    env = made(Counting())
    assert resumes_midway(env)
    env.reset()
    again = made(Counting())
    again.load_state_dict(env.state_dict())
    one, other = (e.step(TensorDict({"action": STILL}, [3]))["next"] for e in (env, again))
    assert torch.equal(one["observation"], other["observation"])
    assert torch.equal(one["begun_at"], other["begun_at"])
