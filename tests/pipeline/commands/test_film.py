"""Films, without a screen: the renderer and the writer are replaced, what moves is real."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from envs import find_task
from envs.adroit import room
from envs.adroit.simulator import HandSimulator
from envs.demonstrations import DemoOptions, load_demonstrations
from envs.door import task
from envs.pictures import Picture
from pipeline.act.recorder import Recorder
from pipeline.commands import film
from pipeline.film import performers
from pipeline.film.choice import Choice
from pipeline.film.performers import LoadedRun
from pipeline.film.takes import Moment
from pipeline.playing import make_evaluator
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe, save_recipe
from tests.pipeline.toys import built, tiny_config

DOORS = 2
PICTURES = 6
"""Of an episode of 10 steps: steps 0, 2, 4, 6, 8 and 10."""


class Poses:
    """A renderer whose picture is the pose of the door that it shows, [1, 30]."""

    closed = 0

    def __init__(self, simulator: HandSimulator, *_: object) -> None:
        self.simulator = simulator

    def render(self, door: int) -> np.ndarray:
        return self.simulator.qpos[door][None]

    def close(self) -> None:
        Poses.closed += 1


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = built(tiny_config("bc_sac", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


@pytest.fixture
def no_screen(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replaces what draws and writes; gives the rates of the films that were begun."""
    rates: list[float] = []

    @contextmanager
    def kept(_out: Path, per_second: float) -> Iterator[list[np.ndarray]]:
        rates.append(per_second)
        yield SEEN

    SEEN.clear()
    monkeypatch.setattr(room, "HandRenderer", Poses)
    monkeypatch.setattr(film, "open_film", kept)
    monkeypatch.setattr(film, "annotated", lambda moment, *_: moment.picture)
    monkeypatch.setattr(film, "HELD_S", 0.0)
    return rates


SEEN: list[np.ndarray] = []


def filmed(run: Path, choice: Choice | None = None, **how: object) -> np.ndarray:
    SEEN.clear()
    film.film(run, run / "film.mp4", choice or Choice(DOORS), **how)  # type: ignore[arg-type]
    return np.concatenate(SEEN)


def acting_with(run: Path, folder: Path, **evaluation: object) -> Path:
    shutil.copytree(run, folder)
    save_recipe(folder, load_recipe(folder).changed(evaluation=evaluation))
    return folder


def test_a_film_shows_every_second_step_of_every_door_and_its_end(
    trained: Path, no_screen: list[float]
):
    Poses.closed = 0
    pictures = filmed(trained)
    assert len(pictures) == DOORS * PICTURES
    assert no_screen == [50.0]  # 100 steps a second, every second one: real time
    assert Poses.closed == 1
    assert (pictures[0] == 0).all()  # the reset pose
    assert np.abs(np.diff(pictures[:PICTURES], axis=0)).sum(axis=1).min() > 0


def test_episodes_are_chosen_by_their_number(trained: Path, no_screen: list[float]):
    both = filmed(trained)
    assert not np.array_equal(both[:PICTURES], both[PICTURES:])  # other doors
    second = filmed(trained, Choice(starts=(1,)))
    np.testing.assert_array_equal(second, both[PICTURES:])
    turned = filmed(trained, Choice(starts=(1, 0)))
    np.testing.assert_array_equal(turned, np.roll(both, PICTURES, axis=0))


def test_a_film_shows_the_policy_as_it_is_evaluated(
    trained: Path, tmp_path: Path, no_screen: list[float]
):
    mean = filmed(trained)
    noisy = acting_with(trained, tmp_path / "noisy", exploration="sample")
    assert np.abs(filmed(noisy) - mean).max() > 0.01
    np.testing.assert_array_equal(filmed(noisy), filmed(noisy))
    # Each episode has noise of its own, the one that its evaluation has.
    run, recorder = LoadedRun.of(noisy), Recorder(DOORS)
    policy, _ = load_policy(run.recipe, run.task, noisy)
    make_evaluator(run.recipe, run.task, episodes=DOORS).run(policy, recorder)
    seen = np.concatenate([path[::2, task.HAND_QPOS] for path, _ in recorder.episodes()])
    np.testing.assert_allclose(filmed(noisy)[:, 1:28], seen, atol=1e-6)
    quiet = acting_with(trained, tmp_path / "quiet", exploration="sample", noise_scale=1e-7)
    np.testing.assert_allclose(filmed(quiet), mean, atol=1e-3)


def test_a_run_beside_itself_does_the_same_twice(trained: Path, no_screen: list[float]):
    left, right = np.split(filmed(trained, with_=str(trained)), 2, axis=1)
    np.testing.assert_array_equal(left, right)
    np.testing.assert_array_equal(left, filmed(trained))


def test_a_run_of_another_task_cannot_stand_beside_it(trained: Path, tmp_path: Path):
    other = tmp_path / "hammer"
    shutil.copytree(trained, other)
    save_recipe(other, load_recipe(other).changed(task={"name": "hammer"}))
    with pytest.raises(ValueError, match=r"WITH=.*is of task hammer and .* of door"):
        filmed(trained, with_=str(other))


def test_a_demonstration_is_played_as_it_was_recorded(
    trained: Path, demos: Path, no_screen: list[float]
):
    """Every second of its poses, and the last one as long as the policy goes on."""
    door = find_task("door")
    run = LoadedRun.of(trained)
    loaded = load_demonstrations(str(demos), door, DemoOptions()).episodes
    opened = performers.performer("demos", run)
    with opened(Picture(), 3) as one:
        title, moments = one.play(0)
        seen = list(moments)
    chosen = int(title.rpartition(" ")[2])
    episode = loaded[chosen]
    steps = [*range(0, episode.length, 3), episode.length]
    assert [moment.step for moment in seen] == steps
    # A pose is the joints of the hand and the door, of which an observation has all but the first.
    poses = np.concatenate([moment.picture for moment in seen])
    np.testing.assert_allclose(
        poses[:, 1:28], episode.observations[steps][:, task.HAND_QPOS], atol=1e-6
    )
    progress = [moment.progress for moment in seen]
    assert episode.progress is not None
    np.testing.assert_array_equal(np.float32(progress), episode.progress[steps])
    assert seen[-1].return_ == pytest.approx(episode.return_, rel=1e-5)


@pytest.mark.parametrize("changed", ["", "x"])
def test_the_demonstration_that_begins_nearest_is_chosen(changed: str):
    class At:
        def __init__(self, *place: float) -> None:
            self.start = {"place": np.array(place)}

    # Standard deviations 0.1 and 50: (2, 0.8) of them away, and (0, 1.2).
    there = [At(0.0, 100.0), At(0.2, 0.0)]
    wanted = {f"place{changed}": np.array([0.2, 60.0])}
    # Of another name, nothing tells where: the episode of that number, counted round.
    assert performers.nearest(6, there, wanted) == (0 if changed else 1)  # type: ignore[arg-type]


def test_what_cannot_be_is_said_before_a_run_is_read(tmp_path: Path):
    with pytest.raises(ValueError, match=r"OUT=.*film\.avi: a film is \.mp4 or \.gif"):
        film.film(tmp_path / "nowhere", tmp_path / "film.avi")


def test_a_film_of_a_hand_says_what_it_touches(trained: Path, no_screen: list[float], monkeypatch):
    notes: list[tuple[str, ...]] = []

    def noted(moment: Moment, *_: object) -> np.ndarray:
        notes.append(moment.notes)
        return moment.picture

    monkeypatch.setattr(film, "annotated", noted)
    filmed(trained, Choice(1))
    assert notes == [("no contact",)] * PICTURES  # in ten steps the hand gets nowhere
