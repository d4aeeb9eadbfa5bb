from __future__ import annotations

import pytest

from envs.one_line import kind_and_text, text_of


def test_several_lines_become_one():
    assert text_of(ValueError(" a\n\tb  c\n")) == "a b c"
    assert kind_and_text(KeyError("a\nb")) == r"KeyError: 'a\nb'"
    assert kind_and_text(OSError("a\n b")) == "OSError: a b"


def test_a_kind_without_a_text_stands_alone():
    assert kind_and_text(ValueError()) == "ValueError:"


@pytest.mark.parametrize(("most", "text"), [(3, "abc..."), (6, "abcdef"), (None, "abcdef")])
def test_a_long_text_is_cut(most: int | None, text: str):
    assert kind_and_text(ValueError("abcdef"), most) == f"ValueError: {text}"
