"""Diagnostics against values that can be worked out."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from pipeline.files.curves import read_lines
from pipeline.files.run_files import LEARNING_CURVE
from pipeline.learn.stepper import BCSACStepper
from pipeline.watch.diagnostics import DemonstrationProbe, TrainingState
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, built, make_loss, tiny_config


class SumOfActions(nn.Module):
    """Two critics: the sum of the action's entries, and ten more."""

    def forward(self, _observation: Tensor, action: Tensor) -> Tensor:
        total = action.sum(-1, keepdim=True)
        return torch.stack([total + 10.0, total])


def rows(count: int, action: float) -> TensorDict:
    return TensorDict(
        {
            "observation": torch.randn(count, OBSERVATION_SIZE),
            "action": torch.full((count, ACTION_SIZE), action),
        },
        [count],
    )


def test_values_are_the_least_critic_s_of_both_actions():
    loss = make_loss()
    loss.critic = SumOfActions()
    training = rows(6, 0.25)
    found = DemonstrationProbe(loss, training, None)()
    assert found["q_demo_actions"] == pytest.approx(0.25 * ACTION_SIZE)
    with torch.no_grad():
        own = loss.actor.get_dist(TensorDict({"observation": training["observation"]}, [6]))
    mean = own.deterministic_sample.sum(-1).mean()
    assert found["q_policy_actions"] == pytest.approx(float(mean), abs=1e-6)
    assert "bc_nll_held_out" not in found


def test_imitation_errors_tell_the_two_sets_apart():
    loss = make_loss()
    near, far = rows(6, 0.0), rows(6, 0.95)
    probe = DemonstrationProbe(loss, near, far)
    first = probe()
    assert first["bc_nll_held_out"] > first["bc_nll_train"]
    swapped = DemonstrationProbe(loss, far, near)()
    assert swapped["bc_nll_held_out"] == pytest.approx(first["bc_nll_train"])


def test_a_probe_looks_at_few_rows_and_changes_nothing():
    loss = make_loss()
    training = rows(1000, 0.5)
    probe = DemonstrationProbe(loss, training, None, limit=16)
    assert len(probe.training) == 16
    state = torch.random.get_rng_state()
    probe()
    assert torch.equal(torch.random.get_rng_state(), state)
    assert "is_demo" not in training.keys()  # noqa: SIM118 - a TensorDict is not a mapping
    assert all(parameter.grad is None for parameter in loss.parameters())


def test_a_probe_s_rows_are_where_the_networks_are():
    probe = DemonstrationProbe(make_loss().to("meta"), rows(6, 0.5), rows(4, 0.5))
    for part in (probe.training, probe.held_out):
        assert {value.device.type for value in part.values()} == {"meta"}


def test_the_training_state_leaves_out_what_was_never_computed():
    stepper = BCSACStepper(make_loss(), actor_lr=1e-3, critic_lr=1e-3, temperature_lr=1e-3)
    assert TrainingState(stepper)() == {
        "actor_updates": 0.0,
        "target_entropy": -float(ACTION_SIZE),
    }
    stepper.last = {"entropy": torch.tensor(2.0), "grad_cosine": torch.tensor(float("nan"))}
    assert TrainingState(stepper)()["entropy"] == 2.0
    assert "grad_cosine" not in TrainingState(stepper)()


def test_every_evaluation_of_a_run_comes_with_its_diagnostics(tmp_path: Path, demos: Path):
    config = tiny_config("dbc_sac", tmp_path, demos, "torch_threads=1", "demos.held_out=1")
    run = built(config)
    run.train()
    first, *_, last = read_lines(run.run_dir / LEARNING_CURVE)
    assert first.keys() <= last.keys()
    assert {
        "wall_s",
        "share_reached",
        "share_latch_turned",
        "grad_norm_rl",
        "grad_norm_bc",
        "grad_cosine",
        "entropy",
        "target_entropy",
        "q_demo_actions",
        "q_policy_actions",
        "bc_nll_train",
        "bc_nll_held_out",
        "train_return",
        "train_success",
    } <= last.keys()
    assert 0 < first["wall_s"] < last["wall_s"]


def test_holding_out_every_demonstration_is_refused(tmp_path: Path, demos: Path):
    config = tiny_config("dbc_sac", tmp_path, demos, "torch_threads=1", "demos.held_out=2")
    with pytest.raises(ValueError, match=r"demos\.held_out must .* got 2 of 2 episodes"):
        built(config)
