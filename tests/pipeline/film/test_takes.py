from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs import EnvOptions, Stage, Task, find_task
from envs.adroit.strategies import HandStrategies
from envs.adroit.touch import FORCES, OPPOSITION, Contacts
from envs.pictures import Render
from pipeline.film.takes import Moment, Studio, stride

STEPS = 7


class Numbered:
    """A renderer whose pictures are numbered."""

    count = 0

    def render(self, index: int = 0) -> np.ndarray:
        self.count += 1
        return np.full((1, 1, 3), self.count, dtype=np.uint8)

    def close(self) -> None: ...


@pytest.fixture
def pendulum() -> Task:
    """With a stage that holds always and one that holds after the second step alone."""
    seen: list[int] = []

    def second(after: object) -> torch.Tensor:
        seen.append(1)
        return torch.tensor([len(seen) == 2])

    stages = (Stage("first", lambda _: torch.tensor([True])), Stage("second", second))
    render = Render(lambda *_: None, 20.0, notes=lambda td: (f"{td.batch_size[0]} copy",))  # type: ignore[arg-type, return-value]
    return replace(find_task("gymnasium:Pendulum-v1"), stages=stages, render=render)


def played(task: Task, every: int, steps: int | None = None) -> list:
    env = task.make_env(EnvOptions(horizon=STEPS, seed=0))
    studio = Studio(task, env, Numbered(), every)
    begun = env.reset()
    act = lambda td: td.set("action", torch.zeros(1, 1))  # noqa: E731
    found = list(studio.play(begun, act, steps))
    env.close()
    return found


def test_pictures_are_of_the_start_of_every_third_step_and_of_the_end(pendulum: Task):
    moments = played(pendulum, 3)
    assert [moment.step for moment in moments] == [0, 3, 6, 7]
    assert [moment.seconds for moment in moments] == pytest.approx([0.0, 0.15, 0.3, 0.35])
    assert [int(moment.picture[0, 0, 0]) for moment in moments] == [1, 2, 3, 4]
    assert moments[0].notes == ("1 copy",)


def test_the_return_is_that_of_all_steps(pendulum: Task):
    every, third = played(pendulum, 1), played(pendulum, 3)
    rewards = [moment.reward for moment in every]
    assert rewards[0] == 0.0
    assert all(reward < 0.0 for reward in rewards[1:])
    assert third[-1].return_ == every[-1].return_ == pytest.approx(sum(rewards))


def test_a_stage_that_was_passed_stays_passed(pendulum: Task):
    stages = [moment.stage for moment in played(pendulum, 1)]
    assert stages == ["", "first", *["second"] * 6]


def test_an_episode_ends_after_the_steps_that_are_asked_for(pendulum: Task):
    assert [moment.step for moment in played(pendulum, 3, steps=4)] == [0, 3, 4]
    assert [moment.step for moment in played(pendulum, 3, steps=0)] == [0]


def test_what_a_task_does_not_tell_is_not_shown(pendulum: Task):
    assert {(m.progress, m.success) for m in played(pendulum, 3)} == {(None, None)}


@pytest.mark.parametrize(("rate", "every"), [(100.0, 2), (50.0, 1), (20.0, 1), (500.0, 10)])
def test_films_run_in_real_time(rate: float, every: int):
    assert stride(Render(None, rate), 50.0) == every  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------- contacts


def test_contacts_are_told_by_what_is_touched():
    contacts = Contacts(
        ("palm", "thumb", "first"), "thumb", ("handle", "panel"), ("handle",), 0, 0, {}
    )
    forces = np.array([[1.0, 0.0], [0.2, 0.01], [0.0, 3.0]])
    assert contacts.touching(forces.reshape(-1), 0.05) == "palm, thumb: handle; first: panel"
    # Parts that touch the same are named once, and what only grazes is left out.
    assert contacts.touching(np.array([0, 0, 2.0, 2.0, 0, 0.01]), 0.05) == "thumb: handle, panel"
    assert contacts.touching(np.zeros(6), 0.05) == "no contact"


def test_a_film_tells_the_contacts_of_the_moment_and_a_task_without_them_none(pendulum: Task):
    contacts = Contacts(("palm",), "palm", ("rod",), ("rod",), 0.0, 0.0, {})
    task = replace(pendulum, strategies=HandStrategies(contacts))

    def moments(force: float) -> Moment:
        studio = Studio(task, task.make_env(EnvOptions(horizon=STEPS, seed=0)), Numbered(), 1)
        begun = studio.env.reset().set(FORCES, torch.tensor([[force]]))
        begun[OPPOSITION] = torch.zeros(1, 1)
        return next(iter(studio.play(begun, lambda td: td)))

    assert moments(1.0).notes == ("palm: rod", "1 copy")
    assert moments(0.01).notes == ("no contact", "1 copy")
    assert played(task, 3)[0].notes == ("1 copy",)  # its environment records none
