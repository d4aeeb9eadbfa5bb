"""Films, without a screen: the renderer and the writer are replaced, what moves is real."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from omegaconf import OmegaConf

from envs.door.simulator import DoorSimulator
from pipeline import film
from pipeline.build import build_run
from pipeline.run_dir import CONFIG
from tests.pipeline.toys import tiny_config

DOORS = 2


class Poses:
    """Renderer and film in one: a picture is the pose of the door that it shows."""

    def __init__(self) -> None:
        self.pictures: list[np.ndarray] = []
        self.closed = 0

    def of(self, simulator: DoorSimulator) -> Poses:
        self.simulator = simulator
        return self

    def render(self, door: int) -> np.ndarray:
        return self.simulator.qpos[door]

    def append_data(self, picture: np.ndarray) -> None:
        self.pictures.append(picture)

    def close(self) -> None:
        self.closed += 1

    def __enter__(self) -> Poses:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = build_run(tiny_config("bc_sac", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


def filmed(run: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    poses = Poses()
    writer = ModuleType("imageio.v2")
    writer.get_writer = lambda out, fps: poses  # type: ignore[attr-defined]
    package = ModuleType("imageio")
    package.v2 = writer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "imageio", package)
    monkeypatch.setitem(sys.modules, "imageio.v2", writer)
    monkeypatch.setattr(film, "DoorRenderer", poses.of)
    film.film(run, run / "film.mp4", DOORS)
    assert poses.closed == 2  # the film and the renderer
    return np.stack(poses.pictures)


def acting_with(run: Path, folder: Path, **evaluation: object) -> Path:
    shutil.copytree(run, folder)
    config = OmegaConf.load(folder / CONFIG)
    config.evaluation.update(evaluation)
    OmegaConf.save(config, folder / CONFIG)
    return folder


def test_a_film_shows_every_second_step_of_every_door(
    trained: Path, monkeypatch: pytest.MonkeyPatch
):
    horizon = OmegaConf.load(trained / CONFIG).env.horizon or 200
    pictures = filmed(trained, monkeypatch)
    assert len(pictures) == DOORS * -(-horizon // film.STRIDE)
    assert (pictures[0] == 0).all()  # the reset pose
    assert np.abs(np.diff(pictures[: len(pictures) // DOORS], axis=0)).sum(axis=1).min() > 0


def test_a_film_shows_the_policy_as_it_is_evaluated(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    mean = filmed(trained, monkeypatch)
    noisy = acting_with(trained, tmp_path / "noisy", exploration="sample")
    assert np.abs(filmed(noisy, monkeypatch) - mean).max() > 0.01
    np.testing.assert_array_equal(filmed(noisy, monkeypatch), filmed(noisy, monkeypatch))
    quiet = acting_with(trained, tmp_path / "quiet", exploration="sample", noise_scale=1e-7)
    np.testing.assert_allclose(filmed(quiet, monkeypatch), mean, atol=1e-3)
