from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs.adroit.contacts import PARTS
from envs.door.contacts import CONTACTS
from pipeline.film.overlay import BLUE, GREEN, GREY, Scale, annotated, fit, font, wrapped
from pipeline.film.takes import Moment

SIZE = (160, 120)
NUMBERS = st.floats(-5, 5)


def moment(**told: object) -> Moment:
    values = {
        "picture": np.full((120, 160, 3), 200, dtype=np.uint8),
        "step": 40,
        "seconds": 0.4,
        "reward": 1.0,
        "return_": 10.0,
        "progress": 0.5,
        "success": False,
        "stage": "reached",
    }
    return Moment(**values | told)  # type: ignore[arg-type]


def count(picture: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Columns with that colour in the row of the bar."""
    return int((picture[-6] == colour).all(axis=-1).sum())


def test_the_bar_is_as_long_as_progress_says():
    # em = max(11, 120/34) = 11; the bar goes from 5 to 160 - 5 and both ends are drawn: 151 px.
    # 0.5 of 2: a quarter of 150 px, rounded to even, with both ends 39.
    picture = annotated(moment(), "a", Scale("rad", 2.0), SIZE)
    assert count(picture, BLUE) == 39
    assert count(picture, GREY) == 151 - 39
    done = annotated(moment(success=True), "a", Scale("rad", 2.0), SIZE)
    assert count(done, GREEN) == 39


def test_without_progress_or_a_full_one_there_is_no_bar():
    for told, scale in ((moment(progress=None), Scale("", 2.0)), (moment(), Scale("m"))):
        picture = annotated(told, "a", scale, SIZE)
        assert count(picture, BLUE) == count(picture, GREY) == 0


def test_the_picture_shows_between_the_lines_and_is_not_changed():
    given = moment()
    picture = annotated(given, "a", Scale(), SIZE)
    assert picture.shape == (120, 160, 3)
    assert (picture[40:60] == 200).all()
    assert picture[:18].min() < 100  # the title's band
    assert (given.picture == 200).all()


def test_further_lines_take_room_of_their_own():
    without = annotated(moment(), "a", Scale(), SIZE)
    with_ = annotated(moment(notes=("thumb 3 N",)), "a", Scale(), SIZE)
    darkened = [int((p[:, 80] < 200).all(axis=-1).sum()) for p in (without, with_)]
    assert darkened[1] > darkened[0] + 10


@pytest.mark.parametrize("size", [480, 240])
def test_contacts_of_all_parts_fit_into_the_picture(size: int):
    everything = "; ".join(f"{', '.join(PARTS)}: {target}" for target in CONTACTS.targets)
    picture = np.full((size, size, 3), 200, dtype=np.uint8)
    shown = annotated(
        moment(picture=picture, notes=(everything,)), "a", Scale("rad", 2.0), (size,) * 2
    )
    # Nothing is written beside the margins of half a letter, and below the title there is picture.
    edges = np.concatenate([shown[:, :4], shown[:, -4:]], axis=1).astype(int)
    assert set(np.unique(edges)) == {70, 200}
    em = max(11, round(size / 34))
    parts = wrapped(everything, em, size - 2 * (em // 2))
    assert " ".join(parts) == everything
    assert all(font(em).getlength(part) <= size - 2 * (em // 2) for part in parts)


def test_a_line_that_fits_and_a_word_that_does_not_stay_whole():
    assert wrapped("a   b", 14, 100) == ["a   b"]
    assert wrapped("a " + "b" * 50, 14, 100) == ["a", "b" * 50]


@given(progress=NUMBERS, empty=NUMBERS, full=NUMBERS)
def test_a_share_is_between_nothing_and_all(progress: float, empty: float, full: float):
    scale = Scale("", full, empty)
    assert 0.0 <= scale.share(progress) <= 1.0
    if abs(full - empty) > 1e-3:
        assert scale.share(empty) == 0.0
        assert scale.share(full) == 1.0


def test_a_scale_begins_where_the_episode_does():
    scale = Scale("m", 0.0).from_(-0.4)  # a distance, as a negative number
    assert scale.share(-0.4) == 0.0
    assert scale.share(-0.1) == pytest.approx(0.75)
    assert Scale("m", 1.0).from_(None) == Scale("m", 1.0)


@pytest.mark.parametrize(
    ("shape", "columns", "rows"),
    [((50, 100), 160, 80), ((120, 60), 60, 120), ((240, 320), 160, 120), ((120, 160), 160, 120)],
)
def test_pictures_of_another_shape_stand_in_the_middle(
    shape: tuple[int, int], columns: int, rows: int
):
    picture = fit(np.full((*shape, 3), 255, dtype=np.uint8), SIZE)
    assert picture.shape == (120, 160, 3)
    lit = (picture > 128).all(axis=-1)
    assert lit.sum() == columns * rows
    np.testing.assert_array_equal(lit, lit[::-1, ::-1])
