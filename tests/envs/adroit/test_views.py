"""Each task's own view keeps in the picture what matters, by where it is: no picture is made."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from envs.adroit.simulator import HandSimulator
from envs.door.definition import VIEW as DOOR_VIEW
from envs.door.hand import DOOR
from envs.hammer import task as hammer
from envs.hammer.definition import VIEW as HAMMER_VIEW
from envs.hammer.hand import HAMMER
from envs.pen.definition import VIEW as PEN_VIEW
from envs.pen.hand import PEN
from envs.relocate import task as relocate
from envs.relocate.definition import VIEW as RELOCATE_VIEW
from envs.relocate.hand import RELOCATE

FINGERS = ("S_grasp", "S_fftip", "S_lftip", "S_thtip")


def in_picture(view, points: NDArray, fovy: float) -> NDArray:
    """Where points [P, 3] are in a square picture, [P, 2]: -1 and 1 are its edges."""
    azimuth, elevation = np.radians([view.azimuth, view.elevation])
    forward = np.array([
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ])  # fmt: skip
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    up = np.cross(right, forward)
    away = points - (np.array(view.lookat) - view.distance * forward)
    depth = away @ forward
    assert (depth > 0).all()
    return np.stack([away @ right, away @ up], 1) / depth[:, None] / np.tan(np.radians(fovy / 2))


def doors() -> Iterator[tuple[dict, NDArray | None]]:
    """Closed and open, at the corners of where doors stand."""
    drawn = np.stack([DOOR.draw(np.random.default_rng(i))["door_position"] for i in range(200)])
    low, high = drawn.min(0), drawn.max(0)
    for corner in itertools.product(*zip(low, high, strict=True)):
        for angle in (0.0, 1.57):
            qpos = np.zeros((1, 30))
            qpos[0, 28] = angle
            yield {"door_position": np.array([corner])}, qpos


def boards() -> Iterator[tuple[dict, NDArray | None]]:
    for height in hammer.BOARD_HEIGHT:
        yield {"board_position": np.array([[0.05, 0.0, height]])}, None


def pens() -> Iterator[tuple[dict, NDArray | None]]:
    for seed in range(8):
        draw = PEN.draw(np.random.default_rng(seed))
        yield {name: value[None] for name, value in draw.items()}, None


def balls() -> Iterator[tuple[dict, NDArray | None]]:
    corners = zip(relocate.TARGET_LOW, relocate.TARGET_HIGH, strict=True)
    for target in itertools.product(*corners):
        for ball in (relocate.BALL_LOW, relocate.BALL_HIGH):
            place = np.append(ball, relocate.BALL_HEIGHT)
            yield {"ball_position": place[None], "target_position": np.array([target])}, None


CASES = {
    "door": (DOOR, DOOR_VIEW, doors, ("S_handle",)),
    "hammer": (HAMMER, HAMMER_VIEW, boards, ("tool", "S_target", "nail_goal")),
    "pen": (PEN, PEN_VIEW, pens, ("object_top", "object_bottom", "target_top", "target_bottom")),
    "relocate": (RELOCATE, RELOCATE_VIEW, balls, ("target", "S_grasp")),
}


@pytest.mark.parametrize("name", CASES)
def test_hand_and_target_are_in_the_picture_wherever_an_episode_begins(name: str):
    task, view, places, sites = CASES[name]
    with HandSimulator(task, 1) as simulator:
        model = simulator.scene.model
        tips = [site for site in FINGERS if site in _sites(model)]
        assert len(tips) >= 2
        for place, qpos in places():
            simulator.start(place, qpos=qpos)
            data = simulator.data(0)
            points = np.stack([data.site(site).xpos for site in (*sites, *tips)])
            where = in_picture(view, points, model.vis.global_.fovy)
            assert np.abs(where).max() < 0.95, (
                place,
                dict(zip((*sites, *tips), where, strict=True)),
            )


def _sites(model) -> set[str]:
    return {model.site(i).name for i in range(model.nsite)}


def test_the_projection_is_mujocos():
    """By hand: looking along y from 2 m, what is 0.5 m to the right is 0.5 / 2 / tan(22.5) off."""
    view = DOOR_VIEW.__class__((0.0, 0.0, 1.0), 2.0, 90.0, 0.0)
    points = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, 0.0, 1.5]])
    expected = 0.5 / 2 / np.tan(np.pi / 8)
    np.testing.assert_allclose(
        in_picture(view, points, 45.0), [[0, 0], [expected, 0], [0, expected]], atol=1e-12
    )
