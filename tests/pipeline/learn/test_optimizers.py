"""Steps of Adam that do without ``Optimizer.step`` are its steps, bit by bit."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from torch import nn

from pipeline.learn.optimizers import AdamStep, make_adam, make_annealing

STEPS = 6


class Learner:
    """A network, a second rate for one more parameter, a frozen one, and a falling rate."""

    def __init__(self, lean: bool) -> None:
        torch.manual_seed(0)
        self.network = nn.Sequential(nn.Linear(3, 4), nn.Linear(4, 2))
        self.temperature = nn.Parameter(torch.tensor(0.5))
        self.frozen = nn.Parameter(torch.ones(2), requires_grad=False)
        groups = [
            (self.network.parameters(), 1e-2),
            ([self.temperature], 1e-1),
            ([self.frozen], 1.0),
        ]
        self.optimizer = make_adam(groups)
        self.annealing = make_annealing(self.optimizer, STEPS)
        self.step = AdamStep(self.optimizer) if lean else self.optimizer.step

    def learn(self, seeds: range) -> None:
        for seed in seeds:
            torch.manual_seed(seed)
            for parameter in (*self.network.parameters(), self.temperature):
                parameter.grad = torch.randn_like(parameter)
            self.step()
            self.annealing.step()

    def numbers(self) -> list[torch.Tensor]:
        parameters = [*self.network.parameters(), self.temperature, self.frozen]
        state = self.optimizer.state
        moments = [value for p in parameters if p in state for value in state[p].values()]
        return [value.detach().clone() for value in (*parameters, *moments)]


def assert_same(mine: Learner, theirs: Learner) -> None:
    for one, other in zip(mine.numbers(), theirs.numbers(), strict=True):
        assert torch.equal(one, other)


@pytest.mark.filterwarnings("error")
def test_steps_are_those_of_the_optimizer():
    lean, plain = Learner(lean=True), Learner(lean=False)
    for learner in (lean, plain):
        learner.learn(range(STEPS))
    assert_same(lean, plain)
    assert torch.equal(lean.frozen, torch.ones(2))


def test_moments_are_made_before_the_first_step_and_change_nothing():
    learner = Learner(lean=True)
    before = [parameter.detach().clone() for parameter in learner.network.parameters()]
    marker = torch.ones(2, 4)
    learner.network[1].weight.grad = marker
    state = learner.step.state()
    assert learner.network[1].weight.grad is marker
    assert all(map(torch.equal, learner.network.parameters(), before))
    moments = learner.optimizer.state
    assert learner.frozen not in moments
    assert len(state) == 4 * len(moments) == 4 * 5
    assert {of_one["step"].item() for of_one in moments.values()} == {0.0}
    known = {tensor.data_ptr() for tensor in state}
    assert all(
        value.data_ptr() in known for of_one in moments.values() for value in of_one.values()
    )


def test_moments_missing_from_a_loaded_state_are_made_and_the_others_stay():
    """So is a run's that was saved while its actor still waited."""
    part = Learner(lean=False)
    part.temperature.grad = torch.tensor(2.0)
    part.optimizer.step()
    lean = Learner(lean=True)
    lean.learn(range(1))
    lean.optimizer.load_state_dict(part.optimizer.state_dict())
    lean.step.state()
    moments = lean.optimizer.state
    assert moments[lean.temperature]["exp_avg"] == part.optimizer.state[part.temperature]["exp_avg"]
    steps = {name: moments[p]["step"].item() for name, p in lean.network.named_parameters()}
    assert moments[lean.temperature]["step"] == 1.0
    assert set(steps.values()) == {0.0}


def test_a_loaded_state_is_gone_on_from():
    """Also where steps were made before it was loaded."""
    lean, plain = Learner(lean=True), Learner(lean=False)
    lean.learn(range(2))
    weights, state = deepcopy(lean.numbers()[:5]), deepcopy(lean.optimizer.state_dict())
    rates = deepcopy(lean.annealing.state_dict())
    lean.learn(range(50, 53))
    lean.optimizer.load_state_dict(state)
    lean.annealing.load_state_dict(rates)
    with torch.no_grad():
        for parameter, before in zip(
            (*lean.network.parameters(), lean.temperature), weights, strict=True
        ):
            parameter.copy_(before)
    for learner, seeds in ((plain, range(2)), (lean, range(2, STEPS)), (plain, range(2, STEPS))):
        learner.learn(seeds)
    assert_same(lean, plain)
