"""Which episodes are imitated."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs.demonstrations import Episode, Provenance, load_demonstrations
from envs.demonstrations.selection import highest_returns
from tests.demonstrations.helpers import still_episode


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


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5, float("nan")])
def test_a_share_out_of_range(share: float) -> None:
    with pytest.raises(ValueError, match=r"demos\.keep_best .* in \(0, 1\], got"):
        highest_returns(episodes_with([1.0]), share)


def test_a_bad_share_is_refused_before_anything_is_read() -> None:
    with pytest.raises(ValueError, match=r"demos\.keep_best"):
        load_demonstrations("no-such-file.h5", keep_best=2.0)


def test_loading_selects() -> None:
    loaded = load_demonstrations("bundled")
    half = load_demonstrations("bundled", keep_best=0.5)
    returns = sorted(e.rewards.sum() for e in loaded.episodes)
    kept = sorted(e.rewards.sum() for e in half.episodes)
    assert kept == returns[len(returns) // 2 :]
    assert half.content_hash != loaded.content_hash
