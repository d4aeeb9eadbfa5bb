"""What multiplication tries next, by what succeeded: numbers worked out by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, MultiplyConfig
from envs.demonstrations.tally import Tally


@dataclass(frozen=True)
class Tried:
    """An attempt, as far as a tally looks at it."""

    source: int
    speed: float


def tally(*attempts: tuple[int, float, bool], sources: int = 2, **settings: object) -> Tally:
    config = MultiplyConfig(
        **{"target_episodes": 8, "balance": 1.5, "speed_low": 1.0, "speed_high": 2.0, **settings}
    )
    made = Tally.empty(sources, config)
    for source, speed, kept in attempts:
        made.record(Tried(source, speed), kept=kept)
    return made


def test_a_source_is_wanted_for_what_it_lacks_and_for_its_success() -> None:
    """At most 1.5 * 8 / 2 = 6 of each; (1 + 1) / (3 + 2) and (0 + 1) / (0 + 2) succeed."""
    found = tally((0, 1.0, True), (0, 1.5, False), (0, 2.0, False))
    np.testing.assert_allclose(found.weights(), [5 / 6 * 2 / 5, 1 / 2])


def test_untried_speeds_are_alike() -> None:
    found = tally(speed_bins=4).speeds()
    assert found.shape == (2, 4)
    assert len(np.unique(found)) == 1


def test_a_speed_is_wanted_for_its_success() -> None:
    """Of source 0 (1 + 1) / (3 + 2) = 0.4 succeed, which counts for two attempts of each half."""
    found = tally((0, 1.1, True), (0, 1.6, False), (0, 1.9, False), speed_bins=2)
    slow, fast = (1 + 2 * 0.4) / (1 + 2), (0 + 2 * 0.4) / (2 + 2)
    np.testing.assert_allclose(found.speeds(), [[slow**2, fast**2], [0.25, 0.25]])


@pytest.mark.parametrize(
    ("speed", "part"), [(1.0, 0), (1.2499, 0), (1.2501, 1), (1.99, 3), (2.0, 3)]
)
def test_speeds_lie_in_equal_parts(speed: float, part: int) -> None:
    (where,) = np.flatnonzero(tally((1, speed, False), speed_bins=4).tried[1])
    assert where == part


def test_one_speed_is_the_first_part() -> None:
    found = tally((0, 1.5, True), speed_low=1.5, speed_high=1.5, speed_bins=3)
    np.testing.assert_array_equal(found.tried[0], [1, 0, 0])


def test_a_source_is_full_whatever_its_speeds() -> None:
    attempts = [(0, speed, True) for speed in np.linspace(1.0, 2.0, 6)]
    assert tally(*attempts[:5], speed_bins=5).room_for(0)
    full = tally(*attempts, speed_bins=5)
    assert not full.room_for(0)
    assert full.weights()[0] == 0.0


def test_rounds_are_as_large_as_what_is_missing_needs() -> None:
    """1 of 3 was kept: (1 + 1) / (3 + 2) = 0.4, so 4 more need 10 attempts."""
    found = tally((0, 1.0, True), (0, 1.0, False), (1, 1.0, False), round_size=64)
    assert found.next_round(missing=4, max_attempts=1000) == 10
    assert found.next_round(missing=4, max_attempts=8) == 5, "3 are made already"
    assert tally(round_size=6).next_round(missing=100, max_attempts=1000) == 6


def test_nothing_to_vary_is_refused() -> None:
    with pytest.raises(DemonstrationError, match="got no episodes"):
        tally(sources=0)
