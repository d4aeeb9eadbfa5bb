"""A window that nobody sees: what is shown in it is real."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs.adroit import room
from envs.pictures import SCREENS, RenderingUnavailableError
from pipeline.commands.play import play
from pipeline.film.choice import Choice
from tests.pipeline.toys import built, tiny_config


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = built(tiny_config("bc", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


class Pane:
    """Stays open for so many pictures, and keeps the poses that it showed."""

    def __init__(self, pictures: int) -> None:
        self.pictures = pictures
        self.poses: list[np.ndarray] = []
        self.simulator: Any = None

    def show(self) -> bool:
        if len(self.poses) == self.pictures:
            return False
        self.poses.append(self.simulator.qpos[0])
        return True


@pytest.fixture
def pane(monkeypatch: pytest.MonkeyPatch) -> Pane:
    made = Pane(1000)

    @contextmanager
    def opened(simulator: Any, _camera: Any) -> Iterator[Pane]:
        made.simulator = simulator
        yield made

    monkeypatch.setattr(room, "open_window", opened)
    monkeypatch.setenv(SCREENS[0], ":99")
    return made


class Clock:
    """Time that passes by sleeping, and by 4 ms whenever somebody looks."""

    def __init__(self) -> None:
        self.now = 0.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        self.now += 0.004
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def test_episodes_are_shown_in_real_time(trained: Path, pane: Pane):
    clock = Clock()
    assert play(trained, Choice(2), sleep=clock.sleep, clock=clock) == 2
    assert len(pane.poses) == 20
    assert np.abs(np.diff(pane.poses[:10], axis=0)).sum(axis=1).min() > 0
    # A step is 10 ms, 4 of which pass by looking at the clock.
    np.testing.assert_allclose(clock.slept, 0.006, atol=1e-9)


def test_without_a_choice_it_goes_on_until_the_window_is_closed(trained: Path, pane: Pane):
    pane.pictures = 35
    assert play(trained, sleep=lambda _: None) == 3
    assert len(pane.poses) == 35


def test_where_there_is_no_display_a_line_says_what_to_do(
    trained: Path, monkeypatch: pytest.MonkeyPatch
):
    for name in SCREENS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(RenderingUnavailableError, match=r"no display .*make video RUN=") as said:
        play(trained)
    assert "\n" not in str(said.value)


def test_a_task_without_a_window_says_so(trained: Path, tmp_path: Path):
    file = tmp_path / "still.py"
    file.write_text(
        "from dataclasses import replace\nfrom envs import find_task\n"
        "door = find_task('door')\n"
        "TASK = replace(door, name='still', render=replace(door.render, window=None))\n"
    )
    with pytest.raises(ValueError, match=r"task still has no window.*make video RUN="):
        play(trained, overrides=[f"task.name={file}"])
