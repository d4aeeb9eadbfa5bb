from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envs.adroit import room
from envs.adroit.simulator import HandSimulator
from pipeline.commands import strip as module
from pipeline.commands.strip import GAP, Layout, strip
from tests.pipeline.toys import built, tiny_config


class Clock:
    """A renderer whose picture is as bright as the forearm is far, and which counts."""

    taken = 0

    def __init__(self, simulator: HandSimulator, width: int, height: int, _camera: object) -> None:
        self.shape = (height, width, 3)

    def render(self, _door: int) -> np.ndarray:
        Clock.taken += 1
        return np.full(self.shape, 20 * Clock.taken, dtype=np.uint8)

    def close(self) -> None: ...


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = built(tiny_config("bc", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    Clock.taken = 0
    monkeypatch.setattr(room, "HandRenderer", Clock)


def test_rows_are_policies_and_columns_are_times(trained: Path, tmp_path: Path):
    out = tmp_path / "new" / "strip.png"
    layout = Layout(columns=3, until=8, size=60)
    written = strip([trained, trained], out, layout, with_="demos")
    assert written == out.stat().st_size <= module.MOST_BYTES
    with Image.open(out) as image:
        seen = np.asarray(image.convert("RGB"))
    header = 15  # px: 1.5 em of 10
    assert seen.shape == (header + 3 * (60 + GAP), 3 * (60 + GAP) - GAP, 3)
    # Steps 0, 4 and 8 of three episodes: nine pictures, in the middle of each cell one of them.
    middles = seen[header + 30 :: 60 + GAP, 30 :: 60 + GAP, 0]
    assert middles.shape == (3, 3)
    np.testing.assert_allclose(middles.ravel(), 20 * np.arange(1, 10), atol=3)


def test_an_episode_that_has_ended_stands_still(trained: Path, tmp_path: Path):
    # 10 steps, and a column every 8 of them: 0, 8 and 10, and then nothing more.
    strip([trained], tmp_path / "strip.png", Layout(columns=5, until=32, size=60))
    with Image.open(tmp_path / "strip.png") as image:
        seen = np.asarray(image.convert("RGB"))[45, 30 :: 60 + GAP, 0]
    np.testing.assert_allclose(seen, [20, 40, 60, 60, 60], atol=3)


def test_a_strip_fits_into_its_bound_or_is_refused(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module, "MOST_BYTES", 50)
    with pytest.raises(ValueError, match=r"does not fit into 50 bytes: fewer columns"):
        strip([trained], tmp_path / "strip.png", Layout(columns=2, size=60))
    assert not (tmp_path / "strip.png").exists()


@pytest.mark.parametrize("given", [{"columns": 1}, {"episode": -1}, {"until": 0}])
def test_layouts_that_cannot_be(given: dict):
    with pytest.raises(ValueError, match="2 columns or more, an episode from 0"):
        Layout(**given)


def test_other_files_are_refused_before_a_run_is_read(tmp_path: Path):
    with pytest.raises(ValueError, match=r"OUT=.*strip\.jpg: a strip is a \.png"):
        strip([tmp_path / "nowhere"], tmp_path / "strip.jpg")
