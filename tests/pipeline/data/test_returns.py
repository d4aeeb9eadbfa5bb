"""The way to the end of an episode, against numbers worked out by hand."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from pipeline.data.mixture import BatchPart, Mixture
from pipeline.data.returns import TO_END, way_to_end
from pipeline.data.rows import ROW_KEYS, TransitionRows, joined
from tests.pipeline.toys import tagged_rows, trajectory

REWARDS = [1.0, 2.0, 4.0, 8.0, 16.0]


def column(steps: TensorDict, key: str) -> list:
    return steps[key].squeeze(-1).tolist()


def test_the_way_to_the_end_by_hand():
    """Rewards 1 2 4 | 8 16 at discount 1/2: a terminal state after the third, a cut at the last.

    4; 2 + 4/2; 1 + 4/2 = 3; then 16 and 8 + 16/2.
    """
    steps = trajectory(REWARDS, terminated=[2])[None]
    way = way_to_end(steps["next"], 0.5)
    assert column(way, "reward") == [[3, 4, 4, 16, 16]]
    assert column(way, "steps") == [[3, 2, 1, 2, 1]]
    assert column(way, "observation") == [[3, 3, 3, 5, 5]]
    assert column(way, "terminated") == [[True, True, True, False, False]]


def test_environments_have_ends_of_their_own():
    """The second ends with its first step: 10; then 20 + 40 + 80 + 160 at discount 1."""
    tens = [10.0 * reward for reward in REWARDS]
    both = torch.stack([trajectory(REWARDS), trajectory(tens, truncated=[0], tag=100)])
    way = way_to_end(both["next"], 1.0)
    assert column(way, "reward") == [[31, 30, 28, 24, 16], [10, 300, 280, 240, 160]]
    assert column(way, "observation") == [[5] * 5, [101, 105, 105, 105, 105]]
    assert not way["terminated"].any()


def test_rows_keep_it_scaled_and_paid_like_their_rewards():
    """0.1 (r + bonus of 1 a step), two-step rows: the end is that of the episode all the same."""
    rows = TransitionRows(
        1.0, n_step=2, reward_scale=0.1, bonus=lambda _: torch.tensor(1.0), to_end=True
    )(trajectory([1.0, 2.0, 4.0], terminated=[2]))
    torch.testing.assert_close(rows[TO_END, "reward"], torch.tensor([[1.0], [0.8], [0.5]]))
    assert column(rows, ("next", "observation")) == [2, 3, 3]
    assert column(rows, (TO_END, "observation")) == [3, 3, 3]
    assert column(rows, (TO_END, "steps")) == [3, 2, 1]


def test_other_rows_beside_them_have_ends_that_are_not_known():
    known = TransitionRows(1.0, to_end=True)(trajectory([1.0, 2.0], terminated=[1]))
    other = TransitionRows(1.0)(trajectory([5.0], tag=9))
    both = joined([other, known], dim=0)
    assert column(both, (TO_END, "steps")) == [0, 2, 1]
    assert column(both, (TO_END, "reward")) == [0, 3, 2]
    assert column(both, "observation") == [9, 0, 1]
    assert TO_END not in other.keys(), "a buffer's own rows stay as they are"  # noqa: SIM118


def test_batches_of_one_source_have_what_it_has():
    class Source:
        def sample(self, n: int) -> TensorDict:
            return tagged_rows(1.0, n)

    batch = Mixture({"main": BatchPart(Source(), 3)}).sample()
    assert set(batch.keys(True, True)) == {*ROW_KEYS, "is_demo"}
