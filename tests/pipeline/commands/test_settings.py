"""``make settings``: what a key means, in a terminal."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.commands.settings import about, keys
from pipeline.recipe import Recipe


def test_a_key_is_told_with_values_default_and_meaning() -> None:
    printed = CliRunner().invoke(app, ["settings", "multiply", "SPEED_LOW"]).stdout
    assert printed.splitlines() == [
        "demos.multiply.speed_low: float > 0 = 1.1",
        "    slowest playback speed (1 = as recorded)",
    ]


def test_every_word_must_occur_in_key_or_meaning() -> None:
    assert [setting.key for setting in about(["multiply", "playback"])] == [
        "demos.multiply.speed_low"
    ]


def test_without_words_every_key_is_told_once() -> None:
    told = [setting.key for setting in about([])]
    sections = {name for name, value in Recipe().plain().items() if isinstance(value, dict)}
    assert len(told) == len(set(told))
    assert set(told) < keys()
    assert sections <= {key.split(".")[0] for key in told}


def test_nothing_found_for_several_words_says_what_each_of_them_finds() -> None:
    with pytest.raises(ValueError, match=r"alone, 'playback' finds 1 and 'lambada' finds none"):
        about(["playback", "lambada"])


def test_nothing_found_says_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"no setting is about 'lambada': .*demos\.multiply"):
        about(["lambada"])
