"""Other speeds and noise of an action sequence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from envs.adroit.variation import correlated_noise, retime

SEQUENCES = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-1, 1)
)


@given(SEQUENCES, st.floats(0.2, 5), st.integers(1, 30))
def test_retiming_stays_within_the_recording(values: np.ndarray, speed: float, steps: int) -> None:
    played = retime(values, speed, steps)
    assert played.shape == (steps, 3)
    np.testing.assert_array_equal(played[0], values[0])
    assert (played <= values.max(axis=0) + 1e-12).all()
    assert (played >= values.min(axis=0) - 1e-12).all()


@given(SEQUENCES)
def test_speed_one_is_the_recording_then_holds(values: np.ndarray) -> None:
    played = retime(values, 1.0, len(values) + 4)
    np.testing.assert_array_equal(played[: len(values)], values)
    np.testing.assert_array_equal(played[len(values) :], np.repeat(values[-1:], 4, axis=0))


def test_double_speed_takes_every_second_entry() -> None:
    values = np.arange(10.0)[:, None] ** 2
    np.testing.assert_allclose(retime(values, 2.0, 5), values[::2])
    np.testing.assert_allclose(retime(np.arange(4.0), 1.5, 3), [0.0, 1.5, 3.0])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_noise_is_stationary_with_the_asked_deviation(correlation: float) -> None:
    noise = correlated_noise(np.random.default_rng(0), (20_000, 28), 0.3, correlation)
    assert noise.shape == (20_000, 28)
    assert noise[:200].std() == pytest.approx(0.3, rel=0.15)
    assert noise[-2000:].std() == pytest.approx(0.3, rel=0.1)
    measured = (noise[1:] * noise[:-1]).mean() / 0.3**2
    assert measured == pytest.approx(correlation, abs=0.03)
