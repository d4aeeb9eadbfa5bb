"""Wall time by parts: none counted twice, none lost."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.files import time_use as module
from pipeline.files.time_use import OTHER, TIME_USE, TimeUse
from pipeline.trainer import Run
from tests.pipeline.toys import built, tiny_config


class Watch:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 1000.0

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Watch:
    watch = Watch()
    monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=watch.perf_counter))
    return watch


def test_a_part_stands_still_while_another_inside_it_runs(watch: Watch):
    use = TimeUse()
    with use.part("outer"):
        watch.wait(1)
        with use.part("inner"):
            watch.wait(2)
            with use.part("innermost"):
                watch.wait(4)
            watch.wait(8)
        watch.wait(16)
        with use.part("inner"):
            watch.wait(32)
        watch.wait(64)
    assert use.seconds == {"outer": 81.0, "inner": 42.0, "innermost": 4.0}


def test_time_outside_of_all_parts_is_nobody_s(watch: Watch):
    use = TimeUse()
    watch.wait(1)
    with use.part("first"):
        watch.wait(2)
    watch.wait(4)
    with use.part("second"):
        watch.wait(8)
    watch.wait(16)
    assert use.seconds == {"first": 2.0, "second": 8.0}


def test_a_part_inside_itself_is_counted_once(watch: Watch):
    use = TimeUse()
    with use.part("a"):
        watch.wait(1)
        with use.part("a"):
            watch.wait(2)
        watch.wait(4)
    assert use.seconds == {"a": 7.0}


TREES = st.recursive(
    st.integers(0, 9), lambda inner: st.tuples(st.sampled_from("abc"), st.lists(inner, max_size=4))
)


@settings(max_examples=60)
@given(children=st.lists(TREES, max_size=5))
def test_the_parts_sum_to_the_whole_however_they_are_nested(children: list):
    watch = Watch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "time", SimpleNamespace(perf_counter=watch.perf_counter))
        use, began = TimeUse(), watch.now
        own = {}

        def play(part: str, children: list) -> None:
            with use.part(part):
                for child in children:
                    if isinstance(child, int):
                        watch.wait(child)
                        own[part] = own.get(part, 0) + child
                    else:
                        play(*child)

        play("root", children)
    assert sum(use.seconds.values()) == watch.now - began
    assert {part: s for part, s in use.seconds.items() if s} == {p: s for p, s in own.items() if s}


def test_an_exception_closes_its_parts(watch: Watch):
    use = TimeUse()

    def fails() -> None:
        with use.part("inner"):
            watch.wait(2)
            raise KeyError("lost")

    with use.part("outer"):
        watch.wait(1)
        with pytest.raises(KeyError, match="lost"):
            fails()
        watch.wait(4)
    with use.part("after"):
        watch.wait(8)
    assert use.seconds == {"outer": 5.0, "inner": 2.0, "after": 8.0}


class Worker:
    """Waits as told."""

    def __init__(self, watch: Watch) -> None:
        self.watch = watch

    def work(self, seconds: float, *, times: int = 1) -> float:
        """Says how long it took."""
        self.watch.wait(seconds * times)
        if seconds == 0:
            raise ValueError("nothing to do")
        return seconds * times


def test_a_watched_method_is_counted_and_otherwise_the_same(watch: Watch):
    use, worker, other = TimeUse(), Worker(watch), Worker(watch)
    use.watch(worker, "work", "labour")
    with use.part("rest"):
        assert worker.work(2, times=3) == 6
        assert other.work(1) == 1  # of the same class, but not watched
        watch.wait(4)
    with pytest.raises(ValueError, match="nothing to do"):
        worker.work(0)
    assert use.seconds == {"labour": 6.0, "rest": 5.0}
    assert worker.work.__doc__ == Worker.work.__doc__


def test_a_timed_function_is_counted_and_otherwise_the_same(watch: Watch):
    use = TimeUse()
    timed = use.timed(Worker(watch).work, "labour")
    assert timed(2, times=2) == 4
    assert timed(3) == 3
    assert use.seconds == {"labour": 7.0}


def test_the_report_names_the_longest_part_first_and_the_sum(watch: Watch, tmp_path: Path):
    use = TimeUse()
    for part, seconds in (("short", 1), ("long", 4), ("middle", 2)):
        with use.part(part):
            watch.wait(seconds)
    use.write(tmp_path)
    report = json.loads((tmp_path / TIME_USE).read_text())
    assert report == {"wall_s": 7.0, "parts_s": {"long": 4.0, "middle": 2.0, "short": 1.0}}
    assert list(report["parts_s"]) == ["long", "middle", "short"]


def test_state_survives_a_round_trip_and_counting_goes_on(watch: Watch):
    use = TimeUse()
    with use.part("a"):
        watch.wait(2)
    saved = use.state_dict()
    assert type(saved) is dict  # and of numbers: a checkpoint keeps it as JSON
    with use.part("a"):
        watch.wait(100)  # what comes later must not reach the state
    restored = TimeUse()
    restored.load_state_dict(saved)
    for part in ("a", "b"):
        with restored.part(part):
            watch.wait(1)
    assert restored.seconds == {"a": 3.0, "b": 1.0}
    assert saved == {"a": 2.0}


# -------------------------------------------------------------------------------- in a whole run

PARTS = {
    "sac": {"setup", "collect", "physics", "store", "sample", "update", "checkpoint", "log"},
    "bc": {"setup", "sample", "update", "evaluate", "checkpoint", "log"},
}


def timed_run(run: Run, monkeypatch: pytest.MonkeyPatch) -> tuple[dict, float]:
    """The report of a run, and what an outer clock says of its training."""
    stamps = []
    train, write = run.trainer.train, run.time_use.write

    def clocked() -> None:
        stamps.append(time.perf_counter())
        train()

    def written(run_dir: Path) -> None:  # when the last checkpoint has its name
        stamps.append(time.perf_counter())
        write(run_dir)

    monkeypatch.setattr(run.trainer, "train", clocked)
    monkeypatch.setattr(run.time_use, "write", written)
    run.train()
    began, ended = stamps
    return json.loads((run.run_dir / TIME_USE).read_text()), ended - began


@pytest.mark.parametrize("variant", PARTS)
def test_a_run_s_parts_are_its_wall_time(
    variant: str, tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    options = ["collector.total_frames=400", "bc.updates=400", "torch_threads=1"]
    config = tiny_config(variant, tmp_path, demos, *options)
    began = time.perf_counter()
    run = built(config)
    building = time.perf_counter() - began
    report, outer = timed_run(run, monkeypatch)
    parts = report["parts_s"]
    assert set(parts) >= PARTS[variant] | {OTHER}
    assert all(seconds > 0 for seconds in parts.values())
    assert report["wall_s"] == pytest.approx(sum(parts.values()))
    assert 0 < parts["setup"] <= building
    # Beyond 1 %, a moment in which a busy machine may have looked elsewhere.
    assert report["wall_s"] == pytest.approx(building + outer, rel=0.01, abs=0.005)


def test_pretraining_counts_as_updates(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, "torch_threads=1", "pretrain=true")
    before_training = built(config).time_use.seconds
    assert before_training["update"] > 0
    assert before_training["demonstrations"] > 0


def test_a_run_that_fails_says_where_its_time_went(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    run = built(tiny_config("sac", tmp_path, demos, "torch_threads=1"))

    def fails() -> None:
        raise RuntimeError("lost power")

    monkeypatch.setattr(run.trainer, "train", fails)
    with pytest.raises(RuntimeError, match="lost power"):
        run.train()
    assert "setup" in json.loads((run.run_dir / TIME_USE).read_text())["parts_s"]


def test_a_resumed_run_goes_on_counting(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    config = tiny_config("sac", tmp_path, demos, "torch_threads=1")
    run = built(config)
    run.trainer.total_frames = 20
    run.train()
    began = time.perf_counter()
    again = built(config, resume=True)
    building = time.perf_counter() - began
    saved = dict(again.time_use.seconds)
    assert {"setup", "collect", "physics", "update"} <= set(saved)
    first = run.time_use.seconds
    for part in ("collect", "physics", "update", "store", "sample"):
        assert saved[part] == pytest.approx(first[part], rel=1e-6)
    # A resumed run is set up a second time.
    assert first["setup"] < saved["setup"] <= first["setup"] + building
    report, outer = timed_run(again, monkeypatch)
    assert report["wall_s"] - sum(saved.values()) == pytest.approx(outer, rel=0.01, abs=0.005)
    for part in ("collect", "physics", "update", "store", "sample"):
        assert report["parts_s"][part] > saved[part]
