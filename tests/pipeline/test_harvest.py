"""Which episodes join D, and what is remembered of them."""

from __future__ import annotations

import math

import pytest
import torch

from pipeline.buffers import GrownDemonstrations
from pipeline.episodes import FinishedEpisode
from pipeline.harvest import AdmissionRule, Harvest
from pipeline.rows import TransitionRows
from tests.pipeline.toys import trajectory


def episode(episode_return: float = 0.0, max_angle: float = math.nan) -> FinishedEpisode:
    return FinishedEpisode(trajectory([episode_return], truncated=[0]), episode_return, max_angle)


@pytest.mark.parametrize(
    ("min_angle", "min_return", "angle", "total", "admitted"),
    [
        (1.35, None, 1.36, -50.0, True),
        (1.35, None, 1.35, 500.0, False),  # "beyond" the threshold, as in Table II
        (1.35, None, math.nan, 500.0, False),  # no hinge
        (None, 10.0, 0.0, 10.0, True),
        (None, 10.0, 2.0, 9.9, False),
        (None, 10.0, math.nan, 11.0, True),  # a return is enough without a hinge
        (1.35, 10.0, 1.4, 10.0, True),
        (1.35, 10.0, 1.4, 9.0, False),
        (1.35, 10.0, 1.3, 11.0, False),
    ],
)
def test_every_bound_that_is_set_must_be_cleared(min_angle, min_return, angle, total, admitted):
    assert AdmissionRule(min_angle, min_return).admits(episode(total, angle)) is admitted


def test_a_rule_without_a_bound_is_refused():
    with pytest.raises(ValueError, match=r"growth\.admission admits every episode"):
        AdmissionRule(min_angle=None, min_return=None)


def test_the_default_is_the_papers_last_threshold():
    assert AdmissionRule() == AdmissionRule(min_angle=1.35, min_return=None)


def test_a_good_episode_joins_with_its_provenance_and_a_bad_one_does_not():
    grown = GrownDemonstrations(capacity=20)
    harvest = Harvest(grown, AdmissionRule(), TransitionRows(0.5, n_step=2), source="policy")
    steps = trajectory([1.0, 2.0, 4.0], truncated=[2])
    steps["next", "hinge_angle"] = torch.tensor([[0.1], [1.4], [0.7]])
    good = FinishedEpisode.from_trajectory(steps)
    harvest(episode(100.0, 0.3), frame=5)
    assert len(grown) == 0
    harvest(good, frame=7)
    (record,) = grown.records
    assert (record.source, record.length, record.frame) == ("policy", 3, 7)
    assert record.episode_return == 7.0
    assert record.max_angle == pytest.approx(1.4)
    # Rows of the same kind as the main buffer's: two rewards each, the last one alone.
    assert grown.buffer[:]["next", "reward"].squeeze(-1).tolist() == [2.0, 4.0, 4.0]
