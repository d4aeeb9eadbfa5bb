"""Values as they are typed behind a key."""

from __future__ import annotations

import pytest

from pipeline.literals import typed
from pipeline.overrides import overridden
from pipeline.recipe import Recipe


@pytest.mark.parametrize(
    ("value", "text"),
    [(("a.py:A", "b.py:B"), "[a.py:A,b.py:B]"), (["a.py:A"], "[a.py:A]"), ((), "[]")],
)
def test_a_list_is_typed_as_it_is_read(value: object, text: str):
    assert typed(value) == text
    assert overridden(Recipe(), f"loss.own_terms={text}").loss.own_terms == tuple(value)


def test_anything_else_is_typed_as_it_is():
    assert [typed(value) for value in ("a,b", 1.5)] == ["a,b", "1.5"]
