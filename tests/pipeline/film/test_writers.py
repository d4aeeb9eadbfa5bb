"""Films as files, with the real writers."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from PIL import Image

from pipeline.film import gif
from pipeline.film.writers import open_film


def grey(value: int, side: int = 32) -> np.ndarray:
    return np.full((side, side, 3), value, dtype=np.uint8)


def write(out: Path, pictures: list[np.ndarray], per_second: float) -> Path:
    with open_film(out, per_second) as film:
        for picture in pictures:
            film.append(picture)
    return out


def durations(path: Path) -> list[int]:
    with Image.open(path) as image:
        found = []
        for i in range(image.n_frames):
            image.seek(i)
            found.append(image.info["duration"])
    return found


def noise(count: int, side: int = 64) -> list[np.ndarray]:
    return list(np.random.default_rng(0).integers(0, 256, (count, side, side, 3), dtype=np.uint8))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # its reader's pipes
def test_an_mp4_holds_the_pictures_in_their_order(tmp_path: Path):
    out = write(tmp_path / "new" / "film.mp4", [grey(20 * i) for i in range(10)], 50.0)
    with imageio.get_reader(out) as read:
        seen = [float(np.mean(picture)) for picture in read]
        assert read.get_meta_data()["fps"] == 50.0
    np.testing.assert_allclose(seen, np.arange(0, 200, 20), atol=4)


def test_a_gif_shows_25_pictures_a_second_for_as_long_as_the_episode_took(tmp_path: Path):
    # 10 pictures in 0.2 s: every second one, for 40 ms each.
    out = write(tmp_path / "film.gif", [grey(20 * i) for i in range(10)], 50.0)
    assert durations(out) == [40] * 5
    # 10 pictures a second are all shown.
    assert durations(write(tmp_path / "slow.gif", [grey(20 * i) for i in range(10)], 10.0)) == (
        [100] * 10
    )


def test_a_gif_becomes_smaller_until_it_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first = write(tmp_path / "first.gif", noise(24), 25.0).stat().st_size
    monkeypatch.setattr(gif, "MOST_BYTES", first // 2)
    second = write(tmp_path / "second.gif", noise(24), 25.0)
    assert second.stat().st_size <= first // 2
    assert sum(durations(second)) == 24 * 40
    monkeypatch.setattr(gif, "MOST_BYTES", 100)
    with pytest.raises(ValueError, match=r"does not fit into 100 bytes: name fewer episodes, or"):
        write(tmp_path / "third.gif", noise(24), 25.0)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["first.gif", "second.gif"]


def test_a_long_film_is_thinned_as_it_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gif, "KEPT", 8)
    # 40 pictures: 9 are too many at the 9th, and again at the 17th and the 33rd.
    out = write(tmp_path / "film.gif", [grey(6 * i) for i in range(40)], 25.0)
    assert durations(out) == [8 * 40] * 5


def test_what_moves_little_costs_little(tmp_path: Path):
    still = noise(1)[0]
    moving = [still.copy() for _ in range(20)]
    for i, picture in enumerate(moving):
        picture[i, i] = 255
    one = write(tmp_path / "one.gif", [still], 25.0).stat().st_size
    assert write(tmp_path / "film.gif", moving, 25.0).stat().st_size < 3 * one


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_that_breaks_off_leaves_the_old_one(name: str, tmp_path: Path):
    out = tmp_path / name
    out.write_text("old")

    def breaks_off() -> None:
        with open_film(out, 25.0) as film:
            film.append(grey(0))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        breaks_off()
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert out.read_text() == "old"


def test_other_endings_are_refused(tmp_path: Path):
    with pytest.raises(ValueError, match=r"OUT=.*film\.webm: a film is \.mp4 or \.gif"):
        open_film(tmp_path / "film.webm", 25.0)
