"""Frontiers of the reverse curriculum, moved by hand."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from pipeline.data.curriculum import ReverseCurriculum


def demonstration(tag: float, observations: int) -> TensorDict:
    """Starts that tell their demonstration and step: tag, tag + 1, ..."""
    return TensorDict({"start": tag + torch.arange(observations)[:, None]}, [observations])


def curriculum(*lengths: int, stride: int = 8, successes: int = 3) -> ReverseCurriculum:
    states = [demonstration(1000.0 * i, length) for i, length in enumerate(lengths)]
    return ReverseCurriculum(states, stride, successes)


def test_a_frontier_moves_after_successes_in_a_row_at_it():
    """From 20 by 8: 12, 4 and 0; there, three more solve it."""
    moving = curriculum(21)
    seen = [moving.frontiers.tolist()]
    for expected in (12, 4, 0, 0):
        for _ in range(2):
            moving.learn((0, int(moving.frontiers[0])), True)
        assert moving.frontiers.tolist() == seen[-1]
        assert not moving.done
        moving.learn((0, int(moving.frontiers[0])), True)
        seen.append(moving.frontiers.tolist())
        assert seen[-1] == [expected]
    assert moving.done
    assert moving.begin(3) is None


def test_a_failure_in_between_holds_it():
    moving = curriculum(21)
    for success in (True, True, False, True, True):
        moving.learn((0, 20), success)
    assert moving.frontiers.tolist() == [20]
    moving.learn((0, 20), True)
    assert moving.frontiers.tolist() == [12]


def test_episodes_from_elsewhere_say_nothing():
    """Begun behind the frontier, at an old one, or as the task's own do."""
    moving = curriculum(21, 31, successes=1)
    moving.learn((0, 20), True)
    for at in ((0, 20), (0, 13), (-1, -1), (1, 12)):
        moving.learn(at, True)
    assert moving.frontiers.tolist() == [12, 30]


def test_it_begins_at_the_frontier_and_a_little_nearer_to_the_end():
    """Of one demonstration with its frontier at 2 of 0 to 5: 2, 3, 4 and 5, 5."""
    torch.manual_seed(0)
    moving = curriculum(6)
    moving.frontiers[0] = 2
    starts, at = moving.begin(8000)
    assert torch.equal(starts["start"].squeeze(-1), at[:, 1].float())
    shares = torch.bincount(at[:, 1], minlength=6) / 8000
    # Four standard deviations of the largest share: 4 sqrt(1/4 / 8000) = 0.022.
    assert shares.tolist() == pytest.approx([0.0, 0.0, 0.5, 0.25, 0.125, 0.125], abs=0.023)


def test_demonstrations_are_drawn_by_what_is_left_of_them():
    """Frontiers at 10 of 10, 5 of 20 and 0 of 10: weights 1, 1/4 and next to none."""
    torch.manual_seed(0)
    moving = curriculum(11, 21, 11)
    moving.frontiers = torch.tensor([10, 5, 0])
    starts, at = moving.begin(5000)
    shares = torch.bincount(at[:, 0], minlength=3) / 5000
    assert shares.tolist() == pytest.approx([0.8, 0.2, 0.0], abs=0.023)
    assert torch.equal(starts["start"].squeeze(-1), (1000 * at[:, 0] + at[:, 1]).float())


def test_one_that_is_solved_waits_for_the_others():
    moving = curriculum(1, 9, successes=1)
    moving.learn((0, 0), True)
    assert moving.solved.tolist() == [True, False]
    assert not moving.done
    assert moving.progress() == {"curriculum": 0.5, "curriculum_done": 0.0}


def test_it_goes_on_where_it_was():
    moving, again = curriculum(21, 9), curriculum(21, 9)
    for _ in range(5):
        moving.learn((0, int(moving.frontiers[0])), True)
    again.load_state_dict(moving.state_dict())
    for one in (moving, again):
        one.learn((0, 12), True)
    assert again.frontiers.tolist() == moving.frontiers.tolist() == [4, 8]


def test_without_demonstrations_there_is_none():
    with pytest.raises(ValueError, match=r"curriculum\.reverse=true needs demonstrations"):
        ReverseCurriculum([], 8, 3)
