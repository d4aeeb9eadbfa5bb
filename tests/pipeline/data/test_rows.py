"""From trajectories to n-step rows, against numbers worked out by hand."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from pipeline.data.progress_bonus import ProgressBonus
from pipeline.data.rows import ROW_KEYS, TransitionRows
from tests.pipeline.toys import trajectory

REWARDS = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]


def column(rows: TensorDict, *key: str) -> list:
    return rows[key].squeeze(-1).tolist()


def test_one_step_rows_are_the_transitions():
    steps = trajectory(REWARDS, terminated=[2])
    rows = TransitionRows(0.5)(steps)
    assert column(rows, "observation") == [0, 1, 2, 3, 4, 5]
    assert column(rows, "next", "observation") == [1, 2, 3, 4, 5, 6]
    assert column(rows, "next", "reward") == REWARDS
    assert column(rows, "steps_to_next_obs") == [1] * 6
    assert column(rows, "next", "terminated") == [False, False, True, False, False, False]


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_three_step_rows_by_hand(end: str):
    """Rewards 1 2 4 | 8 16 32 at discount 1/2: an episode ends after the third, the batch last."""
    rows = TransitionRows(0.5, n_step=3)(trajectory(REWARDS, **{end: [2]}))
    # 1 + 2/2 + 4/4; 2 + 4/2; 4; then 8 + 16/2 + 32/4; and what is left of the batch.
    assert column(rows, "next", "reward") == [3, 4, 4, 24, 32, 32]
    assert column(rows, "next", "observation") == [3, 3, 3, 6, 6, 6]
    assert column(rows, "steps_to_next_obs") == [3, 2, 1, 3, 2, 1]
    # A truncated episode is bootstrapped from, in each row that reaches its end; so is a cut batch.
    ended = end == "terminated"
    assert column(rows, "next", "terminated") == [ended] * 3 + [False] * 3


def test_terminated_belongs_to_the_observation_that_is_bootstrapped_from():
    """The trap: TorchRL's MultiStep leaves done flags at t + 1 while it moves next to t + n."""
    rows = TransitionRows(1.0, n_step=2)(trajectory(REWARDS, terminated=[3]))
    ending = [row["next", "observation"].item() == 4 for row in rows]
    assert ending == [False, False, True, True, False, False]
    assert column(rows, "next", "terminated") == ending


def test_a_batch_of_environments_is_cut_by_environment():
    first = trajectory([1.0, 1.0, 1.0], tag=0)
    second = trajectory([10.0, 10.0, 10.0], terminated=[1], tag=100)
    rows = TransitionRows(1.0, n_step=2)(torch.stack([first, second]))
    assert rows.batch_size == (6,)
    assert column(rows, "observation") == [0, 1, 2, 100, 101, 102]
    assert column(rows, "next", "reward") == [2, 2, 1, 20, 10, 10]
    assert column(rows, "next", "terminated") == [False] * 3 + [True, True, False]


@pytest.mark.parametrize("n_step", [1, 3])
def test_the_reward_scale_multiplies_every_reward(n_step: int):
    steps = trajectory(REWARDS, terminated=[2])
    plain = TransitionRows(0.9, n_step)(steps)
    scaled = TransitionRows(0.9, n_step, reward_scale=0.1)(steps)
    torch.testing.assert_close(scaled["next", "reward"], 0.1 * plain["next", "reward"])


def test_the_bonus_is_paid_for_the_next_observation_before_discounting_and_scaling():
    """Next observations 1, 2, 3 pay 10, 20, 30; an episode of rewards 1 2 4, two-step rows."""
    rows = TransitionRows(
        0.5, n_step=2, reward_scale=0.1, bonus=lambda after: 10.0 * after["observation"]
    )(trajectory(REWARDS[:3], terminated=[2]))
    # 0.1 (11 + 22/2), 0.1 (22 + 34/2), 0.1 * 34
    assert column(rows, "next", "reward") == pytest.approx([2.2, 3.9, 3.4])


def test_the_progress_bonus_grows_up_to_its_cap():
    after = TensorDict({"progress": torch.tensor([[-0.1], [0.0], [1.2], [1.55]])}, [4])
    bonus = ProgressBonus(10.0, cap=1.5)(after)
    assert bonus.shape == (4, 1)
    assert bonus.squeeze(-1).tolist() == pytest.approx([-1.0, 0.0, 12.0, 15.0])
    assert ProgressBonus(10.0)(after).max().item() == pytest.approx(15.5)


@pytest.mark.parametrize("value", [-1.0, float("nan")])
def test_a_senseless_progress_bonus_is_refused(value: float):
    with pytest.raises(ValueError, match=rf"loss\.progress_bonus.*{value}"):
        ProgressBonus(value)


@pytest.mark.parametrize("n_step", [1, 3])
def test_rows_keep_the_columns_that_are_asked_for(n_step: int):
    """As they were before the action, not where the row ends."""
    steps = trajectory(REWARDS)
    steps["progress"] = torch.arange(6.0).unsqueeze(-1)
    rows = TransitionRows(0.9, n_step, columns=["progress"])(steps)
    assert column(rows, "progress") == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("n_step", [1, 3])
@pytest.mark.parametrize("environments", [None, 2])
def test_the_input_is_left_as_it_was(n_step: int, environments: int | None):
    steps = trajectory(REWARDS, terminated=[2], truncated=[4])
    if environments is not None:
        steps = torch.stack([steps] * environments)
    before = steps.clone()
    TransitionRows(
        0.9, n_step, reward_scale=0.1, bonus=lambda after: torch.ones_like(after["reward"])
    )(steps)
    assert set(steps.keys(True, True)) == set(before.keys(True, True))
    assert (steps == before).all()


def test_rows_hold_exactly_what_buffers_share():
    steps = trajectory(REWARDS)
    steps["progress"] = torch.zeros(6, 1)  # of the environment; demonstrations lack it
    rows = TransitionRows(0.9, n_step=2)(steps)
    assert set(rows.keys(True, True)) == set(ROW_KEYS)
    assert rows["steps_to_next_obs"].shape == (6, 1)
    assert rows["next", "reward"].shape == (6, 1)


@pytest.mark.parametrize(("gamma", "n_step"), [(0.9, 0), (1.5, 1)])
def test_senseless_values_are_refused(gamma: float, n_step: int):
    with pytest.raises(ValueError, match=r"."):
        TransitionRows(gamma, n_step)


@pytest.mark.parametrize("n_step", [1, 3])
def test_rows_of_demonstrations_keep_the_action_to_imitate(n_step: int):
    steps = trajectory(REWARDS, truncated=[5])
    steps["imitated_action"] = torch.arange(6.0).unsqueeze(-1)
    rows = TransitionRows(0.9, n_step)(steps)
    assert set(rows.keys(True, True)) == {*ROW_KEYS, "imitated_action"}
    assert column(rows, "imitated_action") == [0, 1, 2, 3, 4, 5]


def test_rows_of_chunks_by_hand():
    """Actions 0, 1, 2 | 3, 4, 5, rewards 1 2 4 | 8 16 32, two at a time at discount 1/2.

    Steps 2 and 5 are the last of their episodes, so no chunk of two begins there.
    """
    steps = trajectory(REWARDS, terminated=[2])
    steps["action"] = torch.arange(6.0).unsqueeze(-1)
    steps["imitated_action"] = 10 + torch.arange(6.0).unsqueeze(-1)
    rows = TransitionRows(0.5, n_step=2, chunk=2)(steps)
    assert rows["action"].tolist() == [[0, 1], [1, 2], [3, 4], [4, 5]]
    assert rows["imitated_action"].tolist() == [[10, 11], [11, 12], [13, 14], [14, 15]]
    assert column(rows, "next", "reward") == [1 + 1, 2 + 2, 8 + 8, 16 + 16]
    assert column(rows, "next", "observation") == [2, 3, 5, 6]
    assert column(rows, "next", "terminated") == [False, True, False, False]
    assert column(rows, "steps_to_next_obs") == [2] * 4
    with pytest.raises(ValueError, match="rows of 3 actions look as many steps ahead, got 2"):
        TransitionRows(0.5, n_step=2, chunk=3)
