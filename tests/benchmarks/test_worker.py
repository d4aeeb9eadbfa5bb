"""The protocol between the parent and its workers, with contestants of known cost."""

from __future__ import annotations

import pytest

from benchmarks.worker import Entry, WorkerError, race, run_once, timed_block
from tests.benchmarks.toys import Sleeper

TOYS = "tests.benchmarks.toys"


def test_a_block_is_divided_by_its_units_and_leaves_the_first_call_out():
    class Counter(Sleeper):
        calls = 0

        def call(self) -> None:
            self.calls += 1
            super().call()

    counter = Counter(0.01)
    per_unit = timed_block(counter, 0.035)
    assert 3 <= counter.calls <= 5  # 1 untimed + at most 4 of 10 ms
    assert per_unit == pytest.approx(0.01 / 2, rel=0.5)


def test_every_contestant_is_timed_in_every_round():
    entries = [
        Entry("slow", f"{TOYS}:Sleeper", {"seconds": 0.02}),
        Entry("fast", f"{TOYS}:Sleeper", {"seconds": 0.002}),
    ]
    timings = race(entries, rounds=3, block_s=0.02)
    assert list(timings) == ["slow", "fast"]
    assert all(len(timing.seconds_per_unit) == 3 for timing in timings.values())
    assert min(timings["slow"].seconds_per_unit) > 0.02 / 2 * 0.99
    assert min(timings["fast"].seconds_per_unit) < 0.01
    assert all(1 < timing.peak_mib < 2000 for timing in timings.values())


def test_two_contestants_of_one_name_are_refused():
    with pytest.raises(ValueError, match="different names"):
        race([Entry("a", "x:y"), Entry("a", "x:y")], rounds=1, block_s=0.1)


@pytest.mark.parametrize(
    ("toy", "message"),
    [("Broken", "(?s)of toy failed.*seven is not even"), ("Dying", r"of toy died \(exit code 3\)")],
)
def test_a_failure_names_the_worker(toy: str, message: str):
    with pytest.raises(WorkerError, match=message):
        race([Entry("toy", f"{TOYS}:{toy}")], rounds=1, block_s=0.01)


def test_a_worker_has_its_threads_before_anything_is_imported():
    result = run_once(f"{TOYS}:surroundings", threads=1, greeting="hello")
    assert result == {"greeting": "hello", "omp": "1", "cores": 1}
