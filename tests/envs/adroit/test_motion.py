"""Where the moving parts of every hand task stand, in observations made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from envs import find_task
from envs.motion import Motion
from tests.envs.adroit.conftest import HANDS

SIZES = {"door": 38, "hammer": 46, "pen": 45, "relocate": 39}


def motion(task: str) -> Motion:
    found = find_task(task).motion
    assert found is not None
    return found


@pytest.mark.parametrize("task", sorted(HANDS))
def test_a_motion_keeps_leading_dimensions_and_tells_the_joints_of_wrist_and_fingers(task):
    of, seen = motion(task), np.random.default_rng(0).uniform(-0.1, 0.1, (2, 3, SIZES[task]))
    for part in (of.effector, of.target):
        assert part(seen).shape == (2, 3, 3)
        assert_allclose(part(seen)[1, 2], part(seen[1, 2]))
    # Two of the wrist, 22 of the fingers; of what an observation holds, behind those of an arm.
    first = {"door": 3, "hammer": 2, "pen": 0, "relocate": 6}[task]
    assert_allclose(of.posture(seen), seen[..., first : first + 24])
    assert of.steps_per_second == 100.0


def test_the_hammers_palm_is_told_from_the_hammer():
    seen = np.zeros((2, SIZES["hammer"]))
    seen[:, 33:36] = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]  # palm
    seen[:, 36:39] = [[0.1, 0.0, 0.0], [9.0, 9.0, 9.0]]  # hammer, which is carried away
    seen[:, 42:45] = 7.0  # the nail
    of = motion("hammer")
    path = of.effector(seen) - of.target(seen[0])
    assert_allclose(path, [[0.0, 0.2, 0.3], [0.3, 0.5, 0.6]])


def test_relocates_palm_is_told_from_where_the_ball_lay():
    target, ball = np.array([0.1, 0.1, 0.3]), np.array([[0.0, 0.2, 0.035], [0.05, 0.1, 0.2]])
    palm = np.array([[0.0, 0.0, 0.2], [0.05, 0.1, 0.25]])
    seen = np.zeros((2, SIZES["relocate"]))
    seen[:, 30:33], seen[:, 33:36], seen[:, 36:39] = palm - ball, palm - target, ball - target
    of = motion("relocate")
    assert_allclose(of.effector(seen) - of.target(seen[0]), palm - ball[0], atol=1e-12)


def test_the_pens_palm_follows_from_the_wrist_and_from_nothing_else():
    seen = np.zeros((4, SIZES["pen"]))
    seen[:, 24:27] = [0.01, -0.2, 0.25]  # pen
    seen[1, 2:24] = 0.3  # fingers
    seen[1, 27:45] = 1.0
    seen[2, 0] = 0.1  # the wrist sideways, rad
    seen[3, 1] = 0.1  # and up or down
    of = motion("pen")
    palm = of.effector(seen)
    assert_allclose(palm[1], palm[0])
    # Its grasp site lies some centimetres from the axes of the wrist.
    for turned in palm[2:]:
        assert 0.003 < np.linalg.norm(turned - palm[0]) < 0.015
    # The pen belongs above the palm, at (0, -0.2, 0.25).
    assert np.linalg.norm(palm[0] - [0.0, -0.2, 0.25]) < 0.06
    assert_allclose(of.target(seen[0]), [0.01, -0.2, 0.25])
