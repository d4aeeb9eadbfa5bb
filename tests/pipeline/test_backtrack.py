"""Going back to the last good policy when training episodes begin to fail."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from pipeline.data.episodes import FinishedEpisode
from pipeline.hooks import BacktrackHook
from tests.pipeline.toys import built, parameters_of, same, tiny_config, trajectory


def episode(opened: bool) -> FinishedEpisode:
    steps = trajectory([0.0], truncated=[0])
    return FinishedEpisode(steps, episode_return=0.0, success=opened, max_progress=1.4)


def offer(hook: BacktrackHook, outcomes: str) -> None:
    """One episode per letter: ``o`` for a door that opens, ``x`` for one that does not."""
    for letter in outcomes:
        hook(episode(letter == "o"), 1000)


class Weight:
    """A module of one number, and a hook over it."""

    def __init__(self, level: float, window: int = 2, memory: int = 2) -> None:
        self.module = nn.Linear(1, 1, bias=False)
        self.set(0.0)
        self.hook = BacktrackHook([self.module], level, window=window, memory=memory)

    def set(self, value: float) -> None:
        nn.init.constant_(self.module.weight, value)

    @property
    def value(self) -> float:
        return self.module.weight.item()


# After two successes the usual rate is (2 + 1) / (2 + 2) = 3/4: both of two episodes fail with a
# chance of 1/16 = 0.0625, at least one fails with 7/16 = 0.4375.
@pytest.mark.parametrize(
    ("level", "outcomes", "goes_back"),
    [
        (0.07, "xx", True),
        (0.06, "xx", False),
        (0.07, "ox", False),
        (0.43, "ox", False),
        (0.44, "xo", True),
        (0.99, "oo", False),
    ],
)
def test_too_few_successes_for_chance_take_the_weights_back(
    level: float, outcomes: str, goes_back: bool
):
    weight = Weight(level)
    offer(weight.hook, "oo")
    weight.set(1.0)
    offer(weight.hook, outcomes)
    assert weight.value == (0.0 if goes_back else 1.0)
    assert weight.hook.counted() == {"backtracks": float(goes_back)}


def returned(hook: BacktrackHook, *returns: float) -> None:
    """One episode a return, of a task that tells no success."""
    for value in returns:
        steps = trajectory([0.0], truncated=[0])
        hook(FinishedEpisode(steps, value, success=None, max_progress=float("nan")), 1000)


# Two returns below all of four others: one of the 6 * 5 / 2 = 15 ways to pick two of six. One below
# all and one in the middle of the four: of the 15, those whose ranks add up to 1 + 4 = 5 or less,
# which are (1, 2), (1, 3), (1, 4) and (2, 3).
@pytest.mark.parametrize(
    ("level", "returns", "goes_back"),
    [
        (0.07, (1.0, 2.0), True),
        (0.06, (1.0, 2.0), False),
        (0.26, (-900.0, 25.0), False),
        (0.27, (-900.0, 25.0), True),
        (0.99, (50.0, 60.0), False),
    ],
)
def test_without_success_too_low_returns_take_the_weights_back(
    level: float, returns: tuple[float, float], goes_back: bool
):
    weight = Weight(level, memory=4)
    returned(weight.hook, 20.0, 10.0, 30.0, 40.0)
    weight.set(1.0)
    returned(weight.hook, *returns)
    assert weight.value == (0.0 if goes_back else 1.0)


def test_returns_that_are_all_alike_say_nothing():
    weight = Weight(level=0.99)
    returned(weight.hook, *[5.0] * 4)
    weight.set(1.0)
    returned(weight.hook, *[5.0] * 4)
    assert weight.value == 1.0


def test_a_window_of_less_than_the_usual_return_is_not_one_to_go_back_to():
    weight = Weight(level=0.07, memory=4)
    for value, returns in [(1.0, (10.0, 20.0)), (2.0, (30.0, 40.0)), (3.0, (5.0, 35.0))]:
        weight.set(value)
        returned(weight.hook, *returns)
    # The third began with 2 and has a median of 20, below 25; the second began with 1.
    weight.set(4.0)
    returned(weight.hook, 1.0, 2.0)
    assert weight.value == 1.0


@pytest.mark.parametrize("spread", [0.1, 1.0])
def test_an_unchanged_return_goes_back_about_as_often_as_the_level_says(spread: float):
    weight = Weight(level=0.05, window=10, memory=100)
    returned(weight.hook, *np.random.default_rng(0).lognormal(3.0, spread, 10_000))
    assert 0 < weight.hook.count < 0.08 * 1000


def test_a_window_below_the_usual_rate_is_not_one_to_go_back_to():
    weight = Weight(level=0.1, memory=8)
    for value, outcomes in [(1.0, "oo"), (2.0, "oo"), (3.0, "ox"), (4.0, "xx")]:
        weight.set(value)
        offer(weight.hook, outcomes)
    # Each window began with the value before its own. Before "ox" the usual rate is 5/6: half of
    # two is no proof (the chance is 0.31) and not good either. Before "xx" it is 6/8, whose chance
    # of nothing is 0.0625: back to the beginning of the second "oo".
    assert weight.value == 1.0
    assert weight.hook.count == 1


def test_the_weights_it_went_back_to_are_those():
    weight = Weight(level=0.07)
    offer(weight.hook, "oo")  # began with 0
    weight.set(1.0)
    offer(weight.hook, "oo")  # began with 0 as well: it was set after the first
    weight.set(2.0)
    offer(weight.hook, "oo")  # began with 1
    weight.set(3.0)
    offer(weight.hook, "xx")
    assert weight.value == 1.0


def test_the_first_window_has_nothing_to_be_compared_with():
    weight = Weight(level=0.99)
    weight.set(1.0)
    offer(weight.hook, "xx")
    assert weight.value == 1.0


@settings(max_examples=25)
@given(st.integers(1, 10), st.floats(0.001, 0.5))
def test_a_policy_that_cannot_do_better_is_let_go(window: int, level: float):
    weight = Weight(level, window=window, memory=40)
    offer(weight.hook, "o" * 40 + "x" * 60)
    before = weight.hook.count
    weight.set(1.0)
    offer(weight.hook, "x" * 400)
    assert weight.hook.count == before
    assert weight.value == 1.0


@pytest.mark.parametrize("rate", [0.5, 0.8, 0.95])
def test_an_unchanged_policy_goes_back_about_as_often_as_the_level_says(rate: float):
    weight = Weight(level=0.05, window=10, memory=100)
    opened = np.random.default_rng(0).random(20_000) < rate
    offer(weight.hook, "".join("o" if one else "x" for one in opened))
    assert 0 < weight.hook.count < 0.05 * 2000


def test_state_survives():
    first, second = Weight(level=0.07), Weight(level=0.07)
    offer(first.hook, "oo")
    first.set(1.0)
    offer(first.hook, "oox")
    second.set(7.0)
    second.hook.load_state_dict(first.hook.state_dict())
    offer(second.hook, "x")
    assert second.value == 0.0
    assert second.hook.count == 1
    third = Weight(level=0.07)
    third.hook.load_state_dict(second.hook.state_dict())
    assert third.hook.count == 1


def test_the_weights_that_a_window_began_with_survive():
    first, second = Weight(level=0.07), Weight(level=0.07)
    first.set(1.0)
    offer(first.hook, "oo")  # the next window begins with 1
    second.set(7.0)
    second.hook.load_state_dict(first.hook.state_dict())
    offer(second.hook, "oo")
    offer(second.hook, "xx")
    assert second.value == 1.0


@pytest.mark.parametrize(
    ("level", "window", "memory", "named"),
    [
        (0.0, 10, 100, r"level must be in \(0, 1\) or null, got 0\.0"),
        (1.0, 10, 100, r"level must be in \(0, 1\) or null, got 1\.0"),
        (0.1, 0, 100, r"window must be at least 1 .* got 0 and 100"),
        (0.1, 10, 9, r"at most backtrack\.memory, got 10 and 9"),
    ],
)
def test_values_that_make_no_sense_are_named(level: float, window: int, memory: int, named: str):
    with pytest.raises(ValueError, match=named):
        BacktrackHook([], level, window=window, memory=memory)


BACKTRACKING = ("backtrack.level=0.07", "backtrack.window=2", "backtrack.memory=2")


def test_actor_and_average_go_back_in_a_run(tmp_path: Path, demos: Path):
    config = tiny_config("bc_sac", tmp_path, demos, *BACKTRACKING, "optim.actor_average=0.9")
    run = built(config)
    actor = run.trainer.loss_module.actor
    before = [p.clone() for p in parameters_of(actor)]
    hook, episodes = run.trainer._modules["backtrack"], run.trainer._modules["episodes"]
    assert episodes.consumers == (hook,)
    offer(hook, "oo")
    with torch.no_grad():
        for module in (actor, run.actor):
            for parameter in module.parameters():
                parameter.add_(1.0)
    offer(hook, "xx")
    assert run.actor is not actor
    assert same(before, parameters_of(actor))
    assert same(before, parameters_of(run.actor))


def test_the_learning_curve_counts(tmp_path: Path, demos: Path):
    def last_row(name: str, *overrides: str) -> dict:
        config = tiny_config("bc_sac", tmp_path / name, demos, *overrides)
        run = built(config)
        run.train()
        lines = (run.run_dir / "learning_curve.jsonl").read_text().splitlines()
        return json.loads(lines[-1])

    assert last_row("on", *BACKTRACKING)["backtracks"] == 0
    assert "backtracks" not in last_row("off")


def test_without_success_it_is_there_and_sees_returns(tmp_path: Path, demos: Path):
    options = ("backtrack.level=0.02", "task.name='gymnasium:Pendulum-v1'", "env.horizon=5")
    run = built(tiny_config("sac", tmp_path, demos, *options))
    run.train()
    hook = run.trainer._modules["backtrack"]
    seen = [*hook.window, *hook.usual]
    assert seen
    assert max(seen) < 0.0  # Pendulum's returns; successes are 0 or 1
