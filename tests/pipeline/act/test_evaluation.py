"""Evaluation: the same episodes every time, counted to their ends and no further."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs import EnvOptions, Stage, find_task
from envs.adroit.starts import placement_of
from envs.door.definition import TASK
from envs.door.hand import DOOR, DOOR_POSITION
from pipeline.act import evaluation
from pipeline.act.evaluation import Evaluator, reset_td, run_wave
from pipeline.act.metrics import Rollouts, summarise
from pipeline.learn.networks import make_actor

ISSUE_COLUMNS = {
    "episodes",
    "return_mean",
    "angle_mean_deg",
    "angle_mean_deg_opened",
    "share_gt_0",
    "share_gt_0_2",
    "share_gt_1_0",
    "share_gt_1_35",
    "success_at_end",
    "steps_to_open_median",
}


@pytest.fixture(scope="module")
def policy() -> nn.Module:
    torch.manual_seed(3)
    return make_actor(38, 28, [8])


def evaluator(**changes) -> Evaluator:
    env_options = EnvOptions(horizon=changes.pop("horizon", 12), num_threads=1)
    options = {"episodes": 5, "seed": 11, "batch": 5, "env_options": env_options} | changes
    return Evaluator(TASK, **options)


@pytest.fixture(scope="module")
def together(policy: nn.Module) -> Rollouts:
    return evaluator().run(policy)


@pytest.fixture
def placed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[np.ndarray]]:
    """Where the doors stood in each wave."""
    seen: list[np.ndarray] = []

    def recorded(env, policy, start, stages=(), limit=None, *watching):
        wave = run_wave(env, policy, start, stages, limit, *watching)
        seen.append(env.simulator.placement[DOOR_POSITION][:limit])
        return wave

    monkeypatch.setattr(evaluation, "run_wave", recorded)
    return seen


@pytest.mark.parametrize("exploration", ["mean", "sample"])
def test_the_batch_size_changes_neither_doors_nor_results(
    policy: nn.Module, exploration: str, placed: list[np.ndarray]
):
    together = evaluator(exploration=exploration).run(policy)
    placed.clear()
    in_waves = evaluator(exploration=exploration, batch=2).run(policy)
    assert [len(wave) for wave in placed] == [2, 2, 1]
    expected = [placement_of(DOOR, 11, i, 0)[DOOR_POSITION] for i in range(5)]
    np.testing.assert_array_equal(np.concatenate(placed), expected)
    assert in_waves.progress.shape == together.progress.shape == (5, 12)
    np.testing.assert_allclose(in_waves.returns, together.returns, atol=1e-3)
    np.testing.assert_array_equal(in_waves.lengths, together.lengths)
    assert len(np.unique(together.returns)) == 5


def test_the_seed_is_that_of_the_list_of_doors(policy: nn.Module, together: Rollouts):
    again, other = evaluator().run(policy), evaluator(seed=12).run(policy)
    np.testing.assert_array_equal(again.returns, together.returns)
    np.testing.assert_array_equal(again.progress, together.progress)
    assert not np.isclose(other.returns, together.returns).any()


def test_less_noise_lies_between_a_sample_and_the_mean_action(
    policy: nn.Module, together: Rollouts
):
    def distance(noise_scale: float) -> float:
        sampled = evaluator(exploration="sample", noise_scale=noise_scale).run(policy)
        return float(np.abs(sampled.returns - together.returns).mean())

    assert distance(1e-6) < 1e-3
    assert distance(1e-6) < distance(0.1) < distance(1.0)


def test_the_noise_has_no_part_in_the_mean_action(policy: nn.Module, together: Rollouts):
    np.testing.assert_array_equal(evaluator(noise_scale=0.5).run(policy).returns, together.returns)


def test_the_mean_action_is_not_a_sample(policy: nn.Module, together: Rollouts):
    samples = [evaluator(exploration="sample").run(policy) for _ in range(2)]
    np.testing.assert_array_equal(samples[0].returns, samples[1].returns)
    assert not np.isclose(samples[0].returns, together.returns).any()


@pytest.mark.parametrize("exploration", ["mean", "sample"])
def test_the_callers_randomness_and_mode_are_left_alone(policy: nn.Module, exploration: str):
    policy.train()
    before, numpy_before = torch.get_rng_state(), np.random.get_state()[1].copy()
    evaluator(episodes=2, exploration=exploration).run(policy)
    assert torch.equal(torch.get_rng_state(), before)
    assert (np.random.get_state()[1] == numpy_before).all()
    assert policy.training


def test_torch_keeps_to_one_thread_until_the_end():
    before, seen = torch.get_num_threads(), []

    class Watching(nn.Module):
        def forward(self, td: TensorDictBase) -> TensorDictBase:
            seen.append(torch.get_num_threads())
            return td.set("action", torch.zeros(*td.batch_size, 28))

    try:
        torch.set_num_threads(2)
        evaluator(episodes=1, horizon=2).run(Watching())
        assert seen == [1, 1]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_the_policy_is_evaluated_in_evaluation_mode():
    modes = []

    class Watching(nn.Module):
        def forward(self, td: TensorDictBase) -> TensorDictBase:
            modes.append(self.training)
            return td.set("action", torch.zeros(*td.batch_size, 28))

    evaluator(episodes=1).run(Watching().train())
    assert set(modes) == {False}


class Countdown(EnvBase):
    """Copy i terminates after i + 1 steps; reward 1 per step; the angle is the step's number."""

    def __init__(self, copies: int) -> None:
        super().__init__(batch_size=[copies])
        shape = (copies, 1)
        self.observation_spec = Composite(
            observation=Unbounded(shape), progress=Unbounded(shape), shape=(copies,)
        )
        self.action_spec = Bounded(-1.0, 1.0, shape)
        self.reward_spec = Unbounded(shape)
        flag = Binary(shape=shape, dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), shape=(copies,))

    def _observed(self) -> dict[str, torch.Tensor]:
        over = self.elapsed > torch.arange(len(self.elapsed)).unsqueeze(-1)
        angle = self.elapsed.float()
        return {"observation": angle, "progress": angle, "done": over, "terminated": over}

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        self.elapsed = torch.zeros(*self.batch_size, 1, dtype=torch.int64)
        return TensorDict(self._observed(), self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.elapsed = self.elapsed + 1
        reward = torch.ones(*self.batch_size, 1)
        return TensorDict(self._observed() | {"reward": reward}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None: ...


def still(td: TensorDictBase) -> TensorDictBase:
    return td.set("action", torch.zeros(*td.batch_size, 1))


def test_an_episode_that_ends_early_is_not_counted_after_its_end():
    wave = run_wave(Countdown(3), still, None)
    assert wave.lengths.tolist() == [1, 2, 3]
    assert wave.returns.tolist() == [1.0, 2.0, 3.0]
    nan = np.nan
    np.testing.assert_array_equal(
        wave.progress, [[1.0, nan, nan], [1.0, 2.0, nan], [1.0, 2.0, 3.0]]
    )
    assert summarise(wave).length_mean == 2.0


def test_a_limit_keeps_the_first_episodes():
    assert run_wave(Countdown(3), still, None, limit=2).lengths.tolist() == [1, 2]


def test_waves_of_different_length_are_joined():
    joined = Rollouts.join([run_wave(Countdown(n), still, None) for n in (1, 2)])
    assert joined.lengths.tolist() == [1, 1, 2]
    np.testing.assert_array_equal(joined.progress, [[1.0, np.nan], [1.0, np.nan], [1.0, 2.0]])


def test_the_columns_of_the_tables_are_plain_numbers(together: Rollouts):
    scalars = evaluator().metrics(together)
    assert set(scalars) >= ISSUE_COLUMNS
    assert json.loads(json.dumps(scalars)) == scalars
    assert scalars["episodes"] == 5
    assert isinstance(scalars["share_gt_1_35_ci95"], list)
    assert scalars["return_mean"] == pytest.approx(together.returns.mean())


def test_other_tasks_report_returns(policy: nn.Module):
    task = find_task("gymnasium:Pendulum-v1")
    pendulum = Evaluator(task, episodes=3, seed=1, batch=2, env_options=EnvOptions(horizon=5))
    runs = [pendulum.run(make_policy_for_pendulum()) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].returns, runs[1].returns)
    scalars = pendulum.metrics(runs[0])
    assert (scalars["episodes"], scalars["length_mean"]) == (3, 5.0)
    assert -100 < scalars["return_mean"] < 0


def make_policy_for_pendulum() -> nn.Module:
    torch.manual_seed(0)
    return make_actor(3, 1, [8])


def test_only_numbered_episodes_can_be_asked_for():
    without = dataclasses.replace(TASK, starts=None)
    assert reset_td(without, Countdown(2), 1, 0) is None
    with_door = TASK.make_env(EnvOptions(num_envs=2, num_threads=1))
    positions = reset_td(TASK, with_door, 1, 3)["door_position"]
    with_door.close()
    expected = [placement_of(DOOR, 1, i, 0)[DOOR_POSITION] for i in (3, 4)]
    np.testing.assert_array_equal(positions, expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noise_scale": 0.0}, r"evaluation\.noise_scale must be positive and finite, got 0\.0"),
        ({"exploration": "random"}, r"evaluation\.exploration must be one of .* got 'random'"),
        ({"episodes": 0}, "must be at least 1, got 0 and 5"),
        ({"batch": 0}, "must be at least 1, got 5 and 0"),
    ],
)
def test_senseless_values_name_their_keys(changes: dict, message: str):
    with pytest.raises(ValueError, match=message):
        evaluator(**changes)


def test_stages_are_reached_at_any_step_of_the_episode_and_not_behind_it():
    """Copy i has progress 1 .. i + 1 and ends there; its numbers go on behind the end."""
    stages = (
        Stage("two", lambda after: after["progress"].squeeze(-1) == 2),
        Stage("three", lambda after: after["progress"].squeeze(-1) == 3),
    )
    wave = run_wave(Countdown(3), still, None, stages)
    assert {label: reached.tolist() for label, reached in wave.stages.items()} == {
        "two": [False, True, True],
        "three": [False, False, True],
    }
    assert summarise(wave).stages == {"two": 2 / 3, "three": 1 / 3}


def test_the_doors_stages_are_those_of_its_table(policy: nn.Module, together: Rollouts):
    """An untrained policy neither comes near the handle in a few steps nor turns the latch."""
    metrics = evaluator().metrics(together)
    assert metrics["stages"] == {
        "reached": 0.0, "latch turned": 0.0, "> 0.2 rad": 0.0, "> 1.0 rad": 0.0, "> 1.35 rad": 0.0
    }  # fmt: skip
    assert (metrics["share_reached"], metrics["share_latch_turned"]) == (0.0, 0.0)


def test_a_door_is_reached_within_a_tenth_of_a_metre_and_turned_beyond_a_radian():
    observation = torch.zeros(3, 38)
    observation[:, 35] = torch.tensor([0.099, 0.101, 0.0])
    observation[:, 27] = torch.tensor([0.0, 0.99, 1.01])
    after = TensorDict({"observation": observation, "progress": torch.full((3, 1), 1.1)}, [3])
    reached = {stage.label: stage.reached(after).tolist() for stage in TASK.stages}
    assert reached["reached"] == [True, False, True]
    assert reached["latch turned"] == [False, False, True]
    assert reached["> 1.0 rad"] == [True] * 3
    assert reached["> 1.35 rad"] == [False] * 3


def test_figures_of_every_task_by_hand():
    """Lengths 3, 2, 1: the first succeeds at its second step only, the second at its end."""
    success = np.array([[0, 1, 0], [0, 1, 0], [0, 0, 0]], dtype=bool)
    progress = np.array([[1.0, 5.0, 2.0], [3.0, 4.0, np.nan], [0.0, np.nan, np.nan]])
    figures = summarise(Rollouts(np.array([1.0, 2.0, 6.0]), np.array([3, 2, 1]), success, progress))
    assert (figures.success_once, figures.success_at_end) == (2 / 3, 1 / 3)
    assert figures.steps_to_success_median == 2.0
    # One step of success in each of two episodes, of three that could last three steps.
    assert figures.success_share == pytest.approx(2 / 9)
    assert (figures.return_mean, figures.length_mean, figures.progress_max_mean) == (3.0, 2.0, 3.0)
    # Wilson's interval of 2 in 3 (z = 1.96): (2 + 1.92 -+ 1.96 sqrt(2/3 + 0.96)) / (3 + 3.84).
    assert figures.success_once_ci95 == pytest.approx((0.2077, 0.9385), abs=1e-3)


def test_a_return_that_is_no_number_is_no_result():
    with pytest.raises(ValueError, match="return of evaluation episode 1 is nan"):
        summarise(Rollouts(np.array([1.0, np.nan]), np.array([1, 1])))
