"""Which episodes join D, and what is remembered of them."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.data.admission import AdmissionRule, EpisodeAdmission, MovingBound
from pipeline.data.buffers import GrownDemonstrations
from pipeline.data.episodes import FinishedEpisode
from pipeline.data.rows import TransitionRows
from tests.pipeline.toys import trajectory


def episode(
    episode_return: float = 0.0, max_progress: float = math.nan, success: bool | None = None
) -> FinishedEpisode:
    steps = trajectory([episode_return], truncated=[0])
    return FinishedEpisode(steps, episode_return, success, max_progress)


@pytest.mark.parametrize(
    ("min_progress", "min_return", "progress", "total", "admitted"),
    [
        (1.35, None, 1.36, -50.0, True),
        (1.35, None, 1.35, 500.0, False),  # "beyond" the threshold, as in Table II
        (1.35, None, math.nan, 500.0, False),  # nobody knows
        (None, 10.0, 0.0, 10.0, True),
        (None, 10.0, 2.0, 9.9, False),
        (None, 10.0, math.nan, 11.0, True),  # a return is enough where nobody knows
        (1.35, 10.0, 1.4, 10.0, True),
        (1.35, 10.0, 1.4, 9.0, False),
        (1.35, 10.0, 1.3, 11.0, False),
    ],
)
def test_every_bound_that_is_set_must_be_cleared(
    min_progress, min_return, progress, total, admitted
):
    rule = AdmissionRule(False, min_progress, min_return)
    assert rule.admits(episode(total, progress)) is admitted


@pytest.mark.parametrize(("success", "admitted"), [(True, True), (False, False), (None, False)])
def test_the_default_is_success_and_where_nobody_knows_there_is_none(success, admitted):
    assert AdmissionRule().admits(episode(5.0, 9.0, success)) is admitted
    assert AdmissionRule(min_return=10.0).admits(episode(9.0, 9.0, success)) is False


@pytest.mark.parametrize(
    ("success", "admitted"),
    [([False, True, True], True), ([False, True, False], False), (None, False)],
    ids=["held", "lost", "not told"],
)
@pytest.mark.parametrize("once", [True, False])
def test_success_at_the_end_can_be_asked_for(
    success: list[bool] | None, once: bool, admitted: bool
):
    steps = trajectory([1.0, 1.0, 1.0], truncated=[2])
    if success is not None:
        steps["next", "success"] = torch.tensor(success)[:, None]
    rule = AdmissionRule(success=once, at_end=True)
    assert rule.admits(FinishedEpisode.from_trajectory(steps)) is admitted


def test_a_rule_without_a_bound_is_refused():
    with pytest.raises(ValueError, match=r"growth\.admission admits every episode"):
        AdmissionRule(success=False)


def test_a_good_episode_joins_with_its_provenance_and_a_bad_one_does_not():
    grown = GrownDemonstrations(capacity=20)
    admission = EpisodeAdmission(
        grown, AdmissionRule(), TransitionRows(0.5, n_step=2), source="policy"
    )
    steps = trajectory([1.0, 2.0, 4.0], truncated=[2])
    steps["next", "progress"] = torch.tensor([[0.1], [1.4], [0.7]])
    steps["next", "success"] = torch.tensor([[False], [True], [False]])
    good = FinishedEpisode.from_trajectory(steps)
    admission(episode(100.0, 0.3, False), frame=5)
    assert len(grown) == 0
    admission(good, frame=7)
    (record,) = grown.records
    assert (record.source, record.length, record.frame) == ("policy", 3, 7)
    assert record.episode_return == 7.0
    assert record.max_progress == pytest.approx(1.4)
    # Rows of the same kind as the main buffer's: two rewards each, the last one alone.
    assert grown.buffer[:]["next", "reward"].squeeze(-1).tolist() == [2.0, 4.0, 4.0]


def test_a_moving_bound_admits_what_is_better_than_usual():
    """The median of the last three returns: none, none, none, then 2, 3, 3, 4."""
    bound = MovingBound(quantile=0.5, window=3)
    offered = [1.0, 2.0, 3.0, 3.0, 2.5, 9.0, 4.0]
    #          filling        | 2.0  3.0  3.0  3.0
    assert [bound.passes(r) for r in offered] == [False, False, False, True, False, True, True]


def test_a_moving_bound_follows_a_policy_that_unlearns():
    bound = MovingBound(quantile=0.5, window=4)
    assert [bound.passes(100.0) for _ in range(4)] == [False] * 4
    assert [bound.passes(10.0) for _ in range(2)] == [False] * 2
    # Three of the four are 10 now.
    assert not bound.passes(10.0)
    assert bound.passes(10.0)


@settings(max_examples=50)
@given(
    returns=st.lists(st.floats(-100, 3000), min_size=30, max_size=30, unique=True),
    quantile=st.floats(0.0, 0.95),
)
def test_a_moving_bound_admits_its_share_of_a_policy_that_stands_still(returns, quantile):
    """Of the episodes that it has seen, offered again in their order."""
    bound = MovingBound(quantile, window=30)
    for value in returns:
        bound.passes(value)
    admitted = sum(bound.passes(value) for value in returns)
    # The quantile lies between two of the 30 returns.
    assert abs(admitted - 30 * (1 - quantile)) <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("quantile", "window", "key"),
    [(1.0, 5, "quantile"), (-0.1, 5, "quantile"), (0.5, 0, "window")],
)
def test_a_moving_bound_out_of_range_is_refused(quantile, window, key):
    with pytest.raises(ValueError, match=rf"growth\.admission\.{key} must be .*got"):
        MovingBound(quantile, window)


def test_a_moving_bound_goes_on_after_a_restart():
    bound, restored = MovingBound(0.5, window=3), MovingBound(0.5, window=3)
    for value in (1.0, 2.0, 3.0, 4.0):
        bound.passes(value)
    restored.load_state_dict(bound.state_dict())
    offered = [2.9, 3.0, 2.0, 3.5]
    assert [restored.passes(r) for r in offered] == [bound.passes(r) for r in offered]
    assert restored.recent.maxlen == 3


def test_both_the_rule_and_the_moving_bound_must_be_cleared_and_the_bound_sees_failures():
    grown = GrownDemonstrations(capacity=20)
    bound = MovingBound(quantile=0.5, window=2)
    admission = EpisodeAdmission(
        grown, AdmissionRule(), TransitionRows(0.5, n_step=1), "policy", bound
    )
    for frame, (total, angle) in enumerate(
        [
            (10.0, 1.5),  # the window fills
            (20.0, 0.1),
            (14.0, 1.5),  # below 15, the median of 10 and 20
            (30.0, 0.1),  # above 17, but no success
            (25.0, 1.5),  # above 22, the median of 14 and 30, and a success
        ]
    ):
        admission(episode(total, angle, success=angle > 1.35), frame)
    assert [r.episode_return for r in grown.records] == [25.0]
