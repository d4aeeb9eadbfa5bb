"""Which episodes are imitated, and up to where."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs.demonstrations import Episode, Provenance
from envs.demonstrations.selection import ended_at, highest_returns
from envs.door import task
from tests.envs.demonstrations.helpers import load_door, still_episode


def episodes_with(returns: list[float]) -> list[Episode]:
    """One-step episodes; their provenance tells which is which."""
    return [
        still_episode(
            steps=1,
            rewards=np.array([r], np.float32),
            provenance=Provenance("synthetic", i, "recorded", {}),
        )
        for i, r in enumerate(returns)
    ]


def which(episodes: list[Episode]) -> list[int]:
    return [e.provenance.episode for e in episodes]


def test_the_highest_returns_stay_in_their_order() -> None:
    episodes = episodes_with([5.0, 1.0, 9.0, 7.0])
    assert which(highest_returns(episodes, 0.5)) == [2, 3]
    assert which(highest_returns(episodes, 0.51)) == [0, 2, 3]  # 2.04 is rounded up
    assert which(highest_returns(episodes, 0.01)) == [2]


def test_of_equal_returns_the_earlier_is_kept() -> None:
    assert which(highest_returns(episodes_with([3.0, 3.0, 3.0]), 0.6)) == [0, 1]


def test_a_return_is_the_sum_of_the_rewards() -> None:
    brief = still_episode(steps=1, rewards=np.array([4.0], np.float32))
    long = still_episode(steps=3, rewards=np.array([2.0, 2.0, 1.0], np.float32))
    assert [e.length for e in highest_returns([brief, long], 0.5)] == [3]


@given(st.lists(st.integers(-99, 99), min_size=1, max_size=12), st.floats(0.01, 1.0))
def test_nothing_left_out_beats_what_is_kept(returns: list[int], share: float) -> None:
    kept = which(highest_returns(episodes_with([float(r) for r in returns]), share))
    left = [r for i, r in enumerate(returns) if i not in kept]
    assert len(kept) >= share * len(returns)
    assert kept == sorted(kept)
    assert not left or max(left) <= min(returns[i] for i in kept)


def door_moving(angles: list[float]) -> Episode:
    """An episode of ``len(angles) - 1`` steps whose hinge is at these angles, one before each."""
    observations = np.zeros((len(angles), 38), np.float32)
    observations[:, task.HINGE] = angles
    return still_episode(steps=len(angles) - 1, observations=observations)


def test_an_episode_ends_with_the_step_that_passes_the_angle() -> None:
    whole = door_moving([0.0, 0.5, 1.2, 1.3, 0.9, 1.4])
    (ended,) = ended_at([whole], 1.25)
    assert ended.length == 3
    np.testing.assert_array_equal(
        ended.observations[:, task.HINGE], np.float32([0.0, 0.5, 1.2, 1.3])
    )
    np.testing.assert_array_equal(ended.actions, whole.actions[:3])
    np.testing.assert_array_equal(ended.rewards, whole.rewards[:3])
    assert ended.max_progress == pytest.approx(1.3)
    assert whole.length == 5  # the input is left as it was


def test_the_end_is_no_terminal_state() -> None:
    (ended,) = ended_at([door_moving([0.0, 1.3, 1.4])], 1.0)
    assert not ended.terminated.any()


def test_an_angle_that_is_never_passed_leaves_the_episode_whole() -> None:
    (ended,) = ended_at([door_moving([0.0, 0.5, 0.5])], 0.5)
    assert ended.length == 2


@given(
    st.lists(st.floats(0.0, 1.5625, width=32), min_size=2, max_size=20),
    st.floats(0.1, 1.5),
)
def test_only_the_last_observation_may_lie_beyond_the_angle(
    angles: list[float], angle: float
) -> None:
    (ended,) = ended_at([door_moving([0.0, *angles])], angle)
    hinge = task.hinge_angle(ended.observations)
    assert 1 <= ended.length <= len(angles)
    assert (hinge[:-1] <= angle).all()
    assert ended.length == len(angles) or hinge[-1] > angle


@pytest.mark.parametrize("angle", [0.0, -1.0, task.FULLY_OPEN, float("nan")])
def test_an_end_progress_out_of_range(angle: float) -> None:
    with pytest.raises(ValueError, match=r"demos\.end_progress .* above 0"):
        load_door("no-such-file.h5", end_progress=angle)  # before anything is read


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5, float("nan")])
def test_a_share_out_of_range(share: float) -> None:
    with pytest.raises(ValueError, match=r"demos\.keep_best .* in \(0, 1\], got"):
        highest_returns(episodes_with([1.0]), share)


def test_a_bad_share_is_refused_before_anything_is_read() -> None:
    with pytest.raises(ValueError, match=r"demos\.keep_best"):
        load_door("no-such-file.h5", keep_best=2.0)


def test_loading_selects() -> None:
    loaded = load_door("bundled")
    half = load_door("bundled", keep_best=0.5)
    returns = sorted(e.rewards.sum() for e in loaded.episodes)
    kept = sorted(e.rewards.sum() for e in half.episodes)
    assert kept == returns[len(returns) // 2 :]
    assert half.content_hash != loaded.content_hash


def test_loading_ends_the_episodes_after_the_choice() -> None:
    best = load_door("bundled", keep_best=0.5)
    ended = load_door("bundled", keep_best=0.5, end_progress=1.0)
    assert [e.length for e in ended.episodes] == [
        1 + int(np.argmax(task.hinge_angle(e.observations[1:]) > 1.0)) for e in best.episodes
    ]
    assert which(list(ended.episodes)) == which(list(best.episodes))
    assert ended.content_hash != best.content_hash


def test_an_ended_episode_ends_in_all_its_steps() -> None:
    executed = np.linspace(-1, 1, 10 * 28, dtype=np.float32).reshape(10, 28)
    observations = np.zeros((11, 38), np.float32)
    observations[4:, task.HINGE] = 1.0
    episode = still_episode(steps=10, observations=observations, executed_actions=executed)
    (ended,) = ended_at([episode], 0.5)
    assert ended.length == 4
    np.testing.assert_array_equal(ended.executed_actions, executed[:4])
