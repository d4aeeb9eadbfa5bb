"""The short form of ``make torture``: no damage goes unnoticed."""

from __future__ import annotations

from tests.faults.torture import OUTCOMES, tortured


def test_no_damage_is_read_as_something_else():
    counts, wrong = tortured(0, 1, each_kind=False, every=3)
    assert wrong == []
    newest, both = counts["newest checkpoint"], counts["both checkpoints"]
    assert newest["fallback"] >= 45
    assert both["refused"] == both.total() >= 50
    assert counts["demonstration cache"]["made again"] >= 2
    assert set().union(*counts.values()) <= set(OUTCOMES)
