"""The hands' variations: the same whatever is beside them, from the task's own starts, honest."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from envs import find_task
from envs.adroit.attempts import Attempt, choose
from envs.adroit.multiplication import HandVariation
from envs.adroit.varying import Guided
from envs.demonstrations import (
    DemonstrationError,
    Episode,
    MultiplyConfig,
    Provenance,
    content_hash,
    multiply,
)
from envs.hammer import task as hammer
from envs.relocate import task as relocate
from tests.envs.adroit.conftest import HANDS, starts_of

LEAST = {"door": -1.0, "hammer": -1.0, "pen": -2.0, "relocate": -9.0}
"""A progress that every episode gets beyond: what is kept needs no skilled hand."""
TASKS = list(HANDS)


def settings(task: str, **changes: Any) -> MultiplyConfig:
    few = {"min_progress": LEAST[task], "horizon": 8, "round_size": 4, "target_episodes": 4}
    return MultiplyConfig(**(few | changes))


def sources(task: str, count: int = 3, steps: int = 10) -> list[Episode]:
    """Gentle random actions from the task's own starts, as its simulator plays them."""
    rng, starts = np.random.default_rng(0), starts_of(task, count)
    hand = HANDS[task]
    recorded = [
        Episode(
            observations=np.zeros((steps + 1, hand.observation_size), np.float32),
            actions=rng.uniform(-0.3, 0.3, (steps, hand.action_size)).astype(np.float32),
            rewards=np.zeros(steps, np.float32),
            terminated=np.zeros(steps, bool),
            provenance=Provenance("somewhere", i, "recorded"),
            start={name: values[i] for name, values in starts.items()},
        )
        for i in range(count)
    ]
    return find_task(task).resimulate(recorded, num_threads=1)


def vary_of(task: str) -> HandVariation:
    found = find_task(task).vary
    assert isinstance(found, HandVariation)
    return found


@pytest.mark.parametrize("task", TASKS)
def test_an_attempt_is_the_same_whatever_is_beside_it(task) -> None:
    episodes, wanted = sources(task), np.array([1.0, 2.0, 0.5])
    with ExitStack() as stack:
        one, other = (
            stack.enter_context(vary_of(task).open(episodes, settings(task, round_size=n), 1))
            for n in (4, 2)
        )
        batch = [one.draw(k, wanted) for k in range(4)]
        assert len({str(placed_at(attempt)) for attempt in batch}) == 4, "each draws its own"
        alone = other.draw(2, wanted)
        np.testing.assert_array_equal(alone.executed_actions, batch[2].executed_actions)
        _, _, beside, _ = one.play(batch)
        (again,) = other.play([alone])
        assert content_hash([beside]) == content_hash([again])
        assert content_hash([beside]) != content_hash([next(one.play(batch))])
        # Another seed is another attempt; so are other weights, once they exclude the source.
        excluded = np.ones(3)
        excluded[alone.source] = 0.0
        assert other.draw(2, excluded).source != alone.source
    with vary_of(task).open(episodes, settings(task, seed=1), 1) as player:
        assert placed_at(player.draw(2, wanted)) != placed_at(alone)


def test_speeds_are_drawn_as_often_as_they_are_wanted() -> None:
    """Of the three parts of [1, 1.6] a quarter, none and three quarters, alike within each."""
    wanted = np.array([[1.0, 0.0, 3.0], [1.0, 1.0, 1.0], [0.0, 1.0, 0.0]])
    config = settings("pen", speed_low=1.0, speed_high=1.6)
    with vary_of("pen").open(sources("pen"), config, 1) as player:
        drawn = [player.draw(k, np.ones(3), wanted) for k in range(900)]
        alike = [player.draw(k, np.ones(3)) for k in range(900)]
        equal = [player.draw(k, np.ones(3), np.ones((3, 5))) for k in range(20)]
    of = {s: np.array([one.speed for one in drawn if one.source == s]) for s in range(3)}
    slow = of[0] < 1.2
    assert not ((of[0] > 1.2 + 1e-9) & (of[0] < 1.4 - 1e-9)).any()
    assert slow.mean() == pytest.approx(0.25, abs=0.09)
    assert of[0][slow].mean() == pytest.approx(1.1, abs=0.03)
    assert of[0][~slow].mean() == pytest.approx(1.5, abs=0.03)
    assert of[1].mean() == pytest.approx(1.3, abs=0.04)
    assert (of[2].min(), of[2].max()) == (
        pytest.approx(1.2, abs=0.01),
        pytest.approx(1.4, abs=0.01),
    )
    assert np.mean([one.speed for one in alike]) == pytest.approx(1.3, abs=0.03)
    # Nothing else of an attempt depends on it.
    assert [one.source for one in drawn] == [one.source for one in alike]
    assert [placed_at(one) for one in drawn] == [placed_at(one) for one in alike]
    np.testing.assert_allclose([one.speed for one in equal], [one.speed for one in alike[:20]])


def placed_at(attempt: Attempt) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in attempt.placement.items()}


@pytest.mark.parametrize("task", TASKS)
def test_what_is_kept_is_what_its_executed_actions_lead_to(task) -> None:
    for noise, differ in ((0.0, False), (0.5, True)):
        kept = multiply(sources(task), settings(task, noise_scale=noise), vary_of(task), 1)
        assert len(kept) == 4
        for episode in kept:
            assert (episode.executed_actions is not None) == differ
            assert np.abs(episode.played_actions).max() <= 1.0
            assert np.abs(episode.actions).max() <= 1.0
            (again,) = find_task(task).resimulate([episode], num_threads=1)
            # Actions are stored as float32, hence not bit for bit.
            np.testing.assert_allclose(again.observations, episode.observations, atol=1e-3)
            # Of a hammer they hold what no observation shows, the speed of its joints.
            np.testing.assert_allclose(again.rewards, episode.rewards, atol=1e-2)
            np.testing.assert_array_equal(again.success, episode.success)
            assert episode.provenance.kind == "multiplied"


@pytest.mark.parametrize("task", TASKS)
def test_provenance_says_how_it_was_made(task) -> None:
    vary, episodes = vary_of(task), sources(task)
    for episode in multiply(episodes, settings(task), vary, 1):
        made = episode.provenance
        details = dict(made.details)
        assert 1.1 <= details.pop("speed") <= 1.6
        assert 0 <= details.pop("noise_scale") <= 0.08
        assert details.pop("attempt") in range(8)
        ((key, apart),) = details.items()
        assert key.endswith(("_m", "_rad"))
        source = episodes[made.episode].start
        assert apart == vary.varying.apart(source, episode.start) > 0
        assert vary.varying.apart(source, source) == pytest.approx(0, abs=1e-7)


def test_starts_come_from_the_reset_distribution() -> None:
    def drawn(task: str) -> list[dict[str, np.ndarray]]:
        with vary_of(task).open(sources(task), settings(task), 1) as player:
            return [dict(player.draw(k, np.ones(3)).placement) for k in range(200)]

    boards = np.stack([one["board_position"] for one in drawn("hammer")])
    np.testing.assert_array_equal(boards[:, :2], np.tile([0.05, 0.0], (200, 1)))
    low, high = hammer.BOARD_HEIGHT
    assert low <= boards[:, 2].min() < low + 0.01
    assert high >= boards[:, 2].max() > high - 0.01
    carried = drawn("relocate")
    for key, low, high in (
        ("ball_position", (*relocate.BALL_LOW, 0.035), (*relocate.BALL_HIGH, 0.035)),
        ("target_position", relocate.TARGET_LOW, relocate.TARGET_HIGH),
    ):
        where = np.stack([one[key] for one in carried])
        assert (where >= low).all()
        assert (where <= high).all()
        assert (np.ptp(where, axis=0) >= 0.9 * (np.array(high) - low)).all()
    asked = np.stack([one["asked_orientation"] for one in drawn("pen")])
    np.testing.assert_allclose(np.linalg.norm(asked, axis=1), 1.0)
    # A turn about x, then y, each by at most 1 rad.
    assert np.cos(0.5) ** 2 <= asked[:, 0].min() < 0.85


def always(guided: Guided) -> Guided:
    """All of every offset at once, in an episode in which nothing is ever reached."""
    return guided._replace(follow=lambda e: [np.ones(e.length) for _ in guided.follow(e)])


@pytest.mark.parametrize("task", ["door", "hammer", "relocate"])
def test_the_arm_alone_is_guided_and_only_where_the_task_says(task) -> None:
    vary, episodes = vary_of(task), sources(task)
    still = [dataclasses.replace(e, actions=np.zeros_like(e.actions)) for e in episodes]
    guided = vary.varying.guided
    assert guided is not None
    moving = dataclasses.replace(vary.varying, guided=always(guided))
    for guide_arm in (True, False):
        variation = dataclasses.replace(vary, varying=moving, guide_arm=guide_arm)
        with variation.open(still, settings(task), 1) as player:
            clean = player.draw(0, np.ones(3)).clean_actions
        assert clean[:, guided.guide.arm].any() == guide_arm
        assert not clean[:, guided.guide.arm.stop :].any()


@pytest.mark.parametrize(("task", "arm"), [("door", 4), ("hammer", 2), ("relocate", 6)])
def test_noise_pushes_the_arm_as_far_as_the_fingers(task, arm) -> None:
    """Its joints move 2.5 times as far as their targets, so its targets move 0.4 times as far."""
    white = settings(task, horizon=2000, noise_scale=0.5, noise_correlation=0.0)
    with vary_of(task).open(sources(task), white, 1) as player:
        attempt = player.draw(0, np.ones(3))
    noise = (attempt.executed_actions - attempt.clean_actions) / attempt.noise_scale
    assert noise[:, :arm].std() == pytest.approx(0.4, rel=0.05)
    assert noise[:, arm:].std() == pytest.approx(1.0, rel=0.05)


def test_each_offset_is_followed_by_its_share() -> None:
    """Relocate's palm goes with the ball, then with the target: two parts of one sum."""
    (episode,) = sources("relocate", 1)
    episode = dataclasses.replace(episode, actions=np.zeros_like(episode.actions))
    varying = vary_of("relocate").varying
    guided = varying.guided
    assert guided is not None
    shares = np.array([[1, 1, 1, 0.5, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0.5, 1, 1, 1, 1, 1, 1]])
    fixed = dataclasses.replace(varying, guided=guided._replace(follow=lambda _: shares))
    exactly = settings("relocate", noise_scale=0.0, speed_low=1.0, speed_high=1.0)
    with dataclasses.replace(vary_of("relocate"), varying=fixed).open([episode], exactly, 1) as p:
        attempt = p.draw(0, np.ones(1))
    per_metre = guided.guide.action_per_metre(
        HANDS["relocate"].scene(), episode.observations[:-1], np.ones(10)
    )
    ball, target = (
        attempt.placement[key] - episode.start[key] for key in ("ball_position", "target_position")
    )
    for step, way in ((1, ball), (3, 0.5 * ball + 0.5 * target), (6, target)):
        expected = (per_metre[step] @ way).clip(-1, 1)
        np.testing.assert_allclose(attempt.clean_actions[step, :6], expected, atol=1e-12)


def test_a_source_is_chosen_by_weight_and_nearness() -> None:
    def shares(apart: list[float], weights: list[float]) -> np.ndarray:
        rng = np.random.default_rng(0)
        drawn = [choose(rng, np.array(apart), np.array(weights), 0.5) for _ in range(4000)]
        return np.bincount(drawn, minlength=len(apart)) / len(drawn)

    # exp(-(0.5 / 0.5)^2) = 0.368 of the weight of one that is at the very place.
    np.testing.assert_allclose(shares([0.0, 0.5], [1, 1]), [0.731, 0.269], atol=0.02)
    np.testing.assert_allclose(shares([0.3, 0.3], [1, 3]), [0.25, 0.75], atol=0.02)
    np.testing.assert_array_equal(shares([0.0, 0.5], [0, 1]), [0, 1])
    # All used up, or all beyond what a float can tell from nothing: the nearest is still chosen.
    np.testing.assert_allclose(shares([0.0, 0.5], [0, 0]), [0.731, 0.269], atol=0.02)
    np.testing.assert_array_equal(shares([50.0, 40.0], [1, 1]), [0, 1])


@pytest.mark.parametrize(("task", "missing"), [
    ("door", "no door position"), ("hammer", "no board position"),
    ("pen", "no asked orientation"), ("relocate", "no ball position and no target position"),
])  # fmt: skip
def test_what_does_not_say_where_things_stand_cannot_be_varied(task, missing) -> None:
    lost = [dataclasses.replace(episode, start={}) for episode in sources(task, 1)]
    with pytest.raises(
        DemonstrationError, match=rf"somewhere, episode 0: has {missing}, .*demos\.resimulate=true"
    ):
        multiply(lost, settings(task), vary_of(task), 1)


@pytest.mark.parametrize(("task", "beyond", "message"), [
    ("hammer", 0.091, r"how far the nail is driven in m below 0\.091, got 0\.091"),
    ("pen", 1.0, r"the cosine of an angle below 1\.0, got 1\.0"),
    ("relocate", 0.0, r"minus the ball's distance .* in m below 0\.0, got 0\.0"),
])  # fmt: skip
def test_a_progress_beyond_all_is_refused(task, beyond, message) -> None:
    with pytest.raises(ValueError, match=rf"demos\.multiply\.min_progress is {message}"):
        multiply(sources(task, 1), settings(task, min_progress=beyond), vary_of(task), 1)


@pytest.mark.parametrize(("task", "key"), [
    ("hammer", "height_scale_m"), ("pen", "angle_scale_rad"), ("relocate", "offset_scale_m"),
])  # fmt: skip
def test_settings_are_checked_and_part_of_the_identity(task, key) -> None:
    vary = vary_of(task)
    with pytest.raises(ValueError, match=rf"{key} must be positive, got -1\.0"):
        dataclasses.replace(vary, scale=-1.0)
    others = [
        vary,
        dataclasses.replace(vary, scale=0.5),
        dataclasses.replace(vary, guide_arm=False),
    ]
    assert len({other.identity for other in others} | {vary_of("door").identity}) == 4
    assert f"({key}=0.5, " in others[1].identity
