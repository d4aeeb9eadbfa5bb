"""What each hand task says of its variations: where the palm is moved, and what is given up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from envs.adroit.multiplication import HandVariation, play_attempts
from envs.adroit.simulator import HandSimulator
from envs.demonstrations import Episode, MultiplyConfig, Provenance
from envs.hammer import task as hammer
from envs.hammer import variation as of_hammer
from envs.pen import task as pen
from envs.pen import variation as of_pen
from envs.relocate import task as relocate
from envs.relocate import variation as of_relocate
from tests.envs.adroit.conftest import HANDS, starts_of


def seen(task: str, steps: int, **changes: Any) -> Episode:
    """An episode of zeros, whose observations and actions can be written."""
    hand, start = HANDS[task], starts_of(task, 1)
    return Episode(
        observations=np.zeros((steps + 1, hand.observation_size), np.float32),
        actions=np.zeros((steps, hand.action_size), np.float32),
        rewards=np.zeros(steps, np.float32),
        terminated=np.zeros(steps, bool),
        provenance=Provenance("written", 0, "resimulated"),
        start={name: values[0] for name, values in start.items()} | changes,
    )


def strike(lifted: int, hit: int, steps: int = 12) -> Episode:
    """The hammer is lifted by action ``lifted`` and the nail gives way at ``hit``."""
    episode = seen("hammer", steps)
    episode.observations[lifted + 1 :, hammer.HAMMER] = [0.0, 0.0, 0.1]
    episode.observations[hit + 1 :, hammer.NAIL] = 0.05
    return episode


def test_the_palm_leaves_its_path_between_lifting_the_hammer_and_the_first_hit() -> None:
    (share,) = of_hammer.follow(strike(4, 8))
    np.testing.assert_allclose(share, [0, 0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])
    for nothing in (strike(4, 20), strike(20, 8), strike(8, 4)):
        (share,) = of_hammer.follow(nothing)
        np.testing.assert_array_equal(share, np.zeros(12))


def carry(near: int, lifted: int, there: int, steps: int = 12) -> Episode:
    """The palm comes near the ball, lifts it, and it comes to the target, by these actions."""
    episode = seen("relocate", steps, target_position=np.array([0.0, 0.0, 0.3]))
    ball_to_palm = episode.observations[:, relocate.BALL_TO_PALM]
    target_to_ball = episode.observations[:, relocate.TARGET_TO_BALL]
    ball_to_palm[:] = [0.0, 0.0, 0.4]
    ball_to_palm[near + 1 :] = [0.0, 0.0, 0.1]
    target_to_ball[:, 2] = 0.035 - 0.3
    target_to_ball[lifted + 1 :, 2] = 0.1 - 0.3
    target_to_ball[there + 1 :] = [0.0, 0.05, 0.0]
    return episode


def test_the_palm_follows_the_ball_until_it_is_lifted_and_then_the_target() -> None:
    ball, target = of_relocate.follow(carry(2, 4, 8))
    np.testing.assert_allclose(ball, [0, 0.5, 1, 1, 1, 0.75, 0.5, 0.25, 0, 0, 0, 0])
    np.testing.assert_allclose(target, [0, 0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])
    # From the ball in the hand on, the two make one whole: nothing jumps.
    np.testing.assert_allclose((ball + target)[2:], 1.0)


@pytest.mark.parametrize("steps", [(20, 4, 8), (2, 20, 8), (2, 4, 20), (0, 4, 8), (6, 4, 8)])
def test_a_source_that_does_not_reach_lift_and_carry_moves_no_palm(steps) -> None:
    for share in of_relocate.follow(carry(*steps)):
        np.testing.assert_array_equal(share, np.zeros(12))


def test_offsets_are_of_the_ball_and_of_the_target() -> None:
    source = {"ball_position": np.array([0.0, 0.1, 0.035]), "target_position": np.full(3, 0.2)}
    new = {"ball_position": np.array([0.1, 0.1, 0.035]), "target_position": np.full(3, 0.3)}
    ball, target = of_relocate.offsets(source, new)
    np.testing.assert_allclose(ball, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(target, [0.1, 0.1, 0.1])
    assert of_relocate.VARYING.apart(source, new) == pytest.approx(0.2)  # of both together
    boards = [{"board_position": np.array([0.05, 0.0, z])} for z in (0.2, 0.13)]
    assert of_hammer.VARYING.apart(*boards) == pytest.approx(0.07)


def test_the_angle_between_pens_ignores_a_turn_about_the_pen() -> None:
    half = np.pi / 8
    about_x, about_z = (np.array([np.cos(half), *(np.sin(half) * axis)]) for axis in np.eye(3)[::2])
    upright = np.array([1.0, 0.0, 0.0, 0.0])

    def angle(*asked: np.ndarray) -> float:
        first, second = ({"asked_orientation": one} for one in asked)
        return of_pen.angle(first, second)

    assert angle(upright, about_x) == pytest.approx(np.pi / 4)
    assert angle(upright, about_z) == pytest.approx(0.0, abs=1e-7)
    assert angle(about_x, -about_x) == pytest.approx(0.0, abs=1e-7)  # the same orientation


def test_it_is_the_direction_that_observations_ask_for() -> None:
    starts = starts_of("pen", 3)
    quaternions = {"asked_orientation": starts["asked_orientation"]}
    with HandSimulator(HANDS["pen"], 3, 1) as simulator:
        asked = simulator.start(quaternions)[:, pen.ASKED]
    expected = [of_pen.pointing(one) for one in starts["asked_orientation"]]
    np.testing.assert_allclose(asked, expected, atol=1e-6)


def test_what_is_under_way() -> None:
    rows = np.zeros((3, 46), np.float32)
    rows[:, hammer.NAIL] = [-0.01, 0.009, 0.011]
    assert of_hammer.VARYING.under_way(rows, {}).tolist() == [False, False, True]
    rows = np.zeros((2, 39), np.float32)
    rows[:, relocate.TARGET_TO_BALL] = [0.0, 0.0, -0.15]
    # The ball is 3 and 5 cm above the table: its target is the copy's own.
    targets = {"target_position": np.array([[0.1, 0.1, 0.18], [0.1, 0.1, 0.20]])}
    assert of_relocate.VARYING.under_way(rows, targets).tolist() == [False, True]
    rows = np.zeros((2, 45), np.float32)
    rows[:, pen.PEN] = [[0, 0, 0.07], [0, 0, 0.2]]
    assert of_pen.VARYING.under_way(rows, {}).tolist() == [False, True]


QUIET = {"noise_scale": 0.0, "min_progress": -9.0, "round_size": 1}


@pytest.mark.parametrize(
    ("vary", "make", "last"),
    # Both begin in action 8, so in action 4 at double speed; then 30 steps of patience.
    [(of_hammer.VARY, lambda: strike(4, 8), 34), (of_relocate.VARY, lambda: carry(2, 8, 10), 34)],
    ids=["hammer", "relocate"],
)
def test_what_is_not_under_way_in_time_is_given_up(
    vary: HandVariation, make: Callable[[], Episode], last: int
) -> None:
    settings = MultiplyConfig(**QUIET, horizon=60, speed_low=2.0, speed_high=2.0)
    with vary.open([make()], settings, 1) as player:
        attempt = player.draw(0, np.ones(1))
        assert attempt.under_way_by == last
        result = play_attempts(player.simulator, [attempt], settings, vary.varying)
        assert result.steps.tolist() == [last + 1]
        assert list(player.play([attempt])) == [None]


def test_a_dropped_pen_is_given_up_at_once() -> None:
    source = seen("pen", 60)
    source.actions[:, :2] = 1.0  # the wrist bends, and the pen rolls off the palm
    settings = MultiplyConfig(**QUIET, horizon=100, speed_low=1.0, speed_high=1.0)
    with of_pen.VARY.open([source], settings, 1) as player:
        attempt = player.draw(0, np.ones(1))
        result = play_attempts(player.simulator, [attempt], settings, of_pen.VARYING)
        height = result.observations[0, : result.steps[0] + 1, pen.PEN][:, 2]
        assert 0 < result.steps[0] < 100
        assert (height[:-1] >= pen.DROPPED).all()
        assert height[-1] < pen.DROPPED
        assert list(player.play([attempt])) == [None]


def test_a_source_that_never_gets_there_gives_no_deadline() -> None:
    settings = MultiplyConfig(**QUIET, horizon=60)
    for source, vary in (
        (strike(4, 20), of_hammer.VARY),
        (carry(2, 20, 20), of_relocate.VARY),
    ):
        with vary.open([source], settings, 1) as player:
            assert player.draw(0, np.ones(1)).under_way_by == 60


@pytest.mark.parametrize("min_progress", [None, 0.9])
@pytest.mark.parametrize("hold", [False, True])
def test_what_is_kept_succeeds_and_the_rest_does_not(
    hold: bool, min_progress: float | None
) -> None:
    """An open hand that only trembles points the pen where it is asked to in a few starts."""
    settings = MultiplyConfig(
        noise_scale=0.6, horizon=30, round_size=60, hold=hold, min_progress=min_progress
    )
    with of_pen.VARY.open([seen("pen", 30)], settings, 1) as player:
        attempts = [player.draw(k, np.ones(1)) for k in range(60)]
        result = play_attempts(player.simulator, attempts, settings, of_pen.VARYING)
        kept = list(player.play(attempts))
    whole = result.steps == 30
    there = pen.success(result.observations[:, 1:])
    if min_progress is not None:
        there = result.progress[:, 1:] > min_progress
    once, held = whole & there.any(axis=1), whole & there[:, -1]
    expected = held if hold else once
    assert [episode is not None for episode in kept] == expected.tolist()
    assert 0 < held.sum() < once.sum() < whole.sum()
