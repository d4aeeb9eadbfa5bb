"""Likeness to demonstrations: distances and smoothness by hand, and what is recorded of whom."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor, TanhNormal
from typer.testing import CliRunner

from envs import find_task
from envs.demonstrations import DemonstrationError, Episode, Provenance
from envs.door.definition import TASK
from envs.motion import Motion
from envs.task import MissingCapabilityError
from pipeline.act.likeness import (
    Comparison,
    Movement,
    likeness,
    mean_nll,
    smoothness,
    warped_distance,
)
from pipeline.act.recorder import Recorder
from pipeline.build import build_run
from pipeline.cli import app
from pipeline.commands.evaluate_run import run_evaluation
from pipeline.commands.extras.likeness import LikenessTo
from pipeline.machine import extras
from tests.pipeline.toys import tiny_config, where, write_demos

MOTION = Motion(
    effector=lambda seen: seen[..., :3],
    target=lambda seen: seen[..., 3:6],
    posture=lambda seen: seen[..., 6:],
    steps_per_second=10.0,
)


def movement(x: list[float], joint: float = 0.0, action: float = 0.0) -> Movement:
    """Along x, with two joints that stand still."""
    path = np.array([[value, 0.0, 0.0] for value in x])
    return Movement(path, np.full((len(x), 2), joint), np.full((len(x) - 1, 2), action))


# ------------------------------------------------------------------------------------ distances


def test_a_warped_distance_is_a_mean_along_the_path():
    a = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    # One beside it, 1 apart, that rests at its end: four pairs, each 1 apart.
    b = np.array([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [2.0, 1.0]])
    assert warped_distance(a, b) == pytest.approx(1.0)


def test_speed_makes_no_difference_to_a_distance():
    slow = np.linspace(0.0, 1.0, 41)[:, None]
    assert warped_distance(slow, slow[::4]) < 0.03  # less than the steps of the faster one


@settings(max_examples=30)
@given(
    st.lists(st.floats(-5, 5), min_size=2, max_size=8),
    st.lists(st.floats(-5, 5), min_size=2, max_size=8),
)
def test_a_distance_is_symmetric_and_nothing_to_itself(first: list[float], second: list[float]):
    a, b = (np.array(values)[:, None] for values in (first, second))
    assert warped_distance(a, a) == 0.0
    assert warped_distance(a, b) >= 0.0
    # Paths of equal cost may be of other lengths, so the means may differ; the costs may not.
    assert (warped_distance(a, b) == 0.0) == (warped_distance(b, a) == 0.0)


# ------------------------------------------------------------------------------------ smoothness


def test_speed_and_jerk_of_a_cubic_path():
    # x = t^3 at 10 steps a second: the third difference of n^3 is 6, so the jerk is 6 m/s^3.
    steps = np.arange(11)
    path = np.stack([(steps / 10.0) ** 3, 0 * steps, 0 * steps], axis=1)
    found = smoothness(path, 10.0)
    assert found["jerk_mean"] == pytest.approx(6.0)
    assert found["speed_mean"] == pytest.approx(1.0)  # 1 m in 1 s
    assert found["speed_peak"] == pytest.approx(2.71)  # 10 * (1 - 0.9^3)
    # Eight third differences: the integral is 8 * 36 / 10, the duration 1 s.
    assert found["log_dimensionless_jerk"] == pytest.approx(-math.log(28.8 / 2.71**2))


def test_dimensionless_jerk_does_not_know_speed():
    path = np.stack([np.sin(np.linspace(0, 1, 30)), np.zeros(30), np.zeros(30)], axis=1)
    slow, fast = smoothness(path, 10.0), smoothness(path, 20.0)
    assert fast["log_dimensionless_jerk"] == pytest.approx(slow["log_dimensionless_jerk"])
    assert fast["jerk_mean"] == pytest.approx(8.0 * slow["jerk_mean"])


@pytest.mark.parametrize("x", [[0.0, 1.0, 2.0], [0.5] * 9])
def test_a_path_without_a_jerk_has_none(x: list[float]):
    assert all(math.isnan(value) for value in smoothness(movement(x).path, 10.0).values())


# ------------------------------------------------------------------------------------ movements


def episode(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Observations [T + 1, 8] that count up; the target begins at (10, 10, 10) and moves."""
    seen = np.arange(steps + 1, dtype=np.float32)[:, None].repeat(8, axis=1)
    seen[:, 3:6] += 10.0
    return seen, np.zeros((steps, 2), dtype=np.float32)


def test_a_movement_ends_at_the_first_success():
    success = np.array([False, True, False, True])
    progress = np.array([0.0, 0.1, 0.9, 0.2])
    found = Movement.of(MOTION, *episode(4), success, progress)
    assert len(found.actions) == 2
    assert found.path.tolist() == [[-10.0] * 3, [-9.0] * 3, [-8.0] * 3]
    assert found.posture[:, 0].tolist() == [0.0, 1.0, 2.0]


def test_without_success_it_ends_at_the_largest_progress_and_without_both_with_the_episode():
    progress = np.array([0.0, 0.1, 0.9, 0.2])
    assert len(Movement.of(MOTION, *episode(4), np.zeros(4, dtype=bool), progress).actions) == 3
    assert len(Movement.of(MOTION, *episode(4), None, None).actions) == 4


def test_policies_are_compared_with_the_nearest_and_demonstrations_with_the_nearest_other():
    shown = [movement([0.0, 1.0], 0.0), movement([3.0, 4.0], 0.0), movement([7.0, 8.0], 0.5)]
    own = [movement([2.5, 3.5], 0.25, action=1.0)]
    found = likeness(own, shown, 10.0)
    assert (found["episodes"], found["demonstrations"]) == (1, 3)
    assert found["path_distance"] == pytest.approx([0.5] * 3)
    # Two joints, each 0.25 rad away: their root mean square.
    assert found["posture_distance"] == pytest.approx([0.25] * 3)
    assert found["saturated_actions"] == [1.0] * 3
    assert found["jerk_mean"] is None
    theirs = found["of_demonstrations"]
    assert theirs["path_distance"][1] == pytest.approx(3.0)  # of 3, 3 and 4
    assert theirs["saturated_actions"] == [0.0] * 3


# ------------------------------------------------------------------------------------ recording


def step(value: float, copies: int) -> TensorDict:
    seen = torch.full((copies, 1), value)
    return TensorDict(
        {"observation": seen, "action": -seen, "next": {"observation": seen + 1}}, [copies]
    )


def test_a_recorder_keeps_whole_episodes_of_different_lengths_in_their_order():
    recorder = Recorder(3)
    for value, active in ((0.0, [True, True]), (1.0, [True, False]), (2.0, [True, False])):
        recorder(step(value, 2), torch.tensor(active)[:, None])
    recorder.finish_wave()
    recorder(step(5.0, 2), torch.tensor([[True], [True]]))
    recorder.finish_wave()
    seen = [(o[:, 0].tolist(), a[:, 0].tolist()) for o, a in recorder.episodes()]
    assert seen == [
        ([0.0, 1.0, 2.0, 3.0], [0.0, -1.0, -2.0]),
        ([0.0, 1.0], [0.0]),
        ([5.0, 6.0], [-5.0]),  # the third and last
    ]


# ------------------------------------------------------------------------------------ end to end


def test_an_evaluation_with_demonstrations_says_how_alike_it_is(tmp_path: Path, demos: Path):
    config = tiny_config("bc", tmp_path, demos, "torch_threads=1")
    build_run(config, where(config)).train()
    # The second wave plays an episode beside the third.
    asked = ["--episodes", "3", "--demos", str(demos), "evaluation.batch=2"]
    command = ["eval", str(where(config)), *asked]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    found = json.loads((where(config) / "evaluation.json").read_text())["likeness"]
    assert (found["to"], found["episodes"], found["demonstrations"]) == (demos.name, 3, 2)
    low, middle, high = found["path_distance"]
    assert 0.0 < low <= middle <= high < 1.0  # m
    assert found["of_demonstrations"]["posture_distance"][1] > 0.0
    without = run_evaluation(where(config), episodes=2)
    assert "likeness" not in without.metrics


def test_one_demonstration_has_no_other_to_be_compared_with(tmp_path: Path):
    path = write_demos(tmp_path / "one.h5", episodes=1)
    with pytest.raises(DemonstrationError, match="holds one episode"):
        Comparison.to(str(path), TASK, 1)


def test_a_task_must_say_where_its_parts_stand():
    task = find_task("gymnasium:Pendulum-v1")
    with pytest.raises(MissingCapabilityError, match="needs a task that says where its moving"):
        Comparison.to("demos.h5", task, 1)


def test_the_missing_extra_is_named_before_anything_is_played(
    tmp_path: Path, demos: Path, monkeypatch
):
    config = tiny_config("bc", tmp_path, demos, "torch_threads=1")
    build_run(config, where(config)).train()
    monkeypatch.delitem(sys.modules, "dtaidistance")
    monkeypatch.setattr(extras, "find_spec", lambda module: None)
    with pytest.raises(extras.MissingExtraError, match=r"dtaidistance, .* the extra 'likeness'"):
        run_evaluation(where(config), extras=[LikenessTo(str(demos))])


def test_the_likelihood_of_demonstrations_is_that_of_their_actions():
    """Of a standard normal behind tanh: 0.9189 nats at 0; at 0.99, where 1 is moved to, 0.5044."""
    head = TensorDictModule(
        lambda seen: (torch.zeros(len(seen), 2), torch.ones(len(seen), 2)),
        ["observation"],
        ["loc", "scale"],
    )
    actor = ProbabilisticActor(head, in_keys=["loc", "scale"], distribution_class=TanhNormal)
    actor.register_parameter("of_a_device", torch.nn.Parameter(torch.zeros(1)))
    seen, played = np.zeros((3, 4), dtype=np.float32), np.zeros((2, 2), dtype=np.float32)
    still = Episode(
        seen, played, np.zeros(2), np.zeros(2, dtype=bool), Provenance("n", 0, "policy")
    )
    pushed = dataclasses.replace(still, actions=np.ones_like(played))
    assert mean_nll(actor, [still], 0.01) == pytest.approx(2 * 0.91894, abs=1e-4)
    assert mean_nll(actor, [pushed], 0.01) == pytest.approx(2 * 0.5044, abs=1e-3)
    both = mean_nll(actor, [still, pushed], 0.01)
    assert both == pytest.approx(0.91894 + 0.5044, abs=1e-3)
