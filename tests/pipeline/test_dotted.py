"""Nested settings by dotted key, and back."""

from __future__ import annotations

from pipeline.dotted import flatten, join, names, nest, put

NESTED = {"seed": 3, "loss": {"gamma": 0.9, "bc_weight": {"init": 1.0}}, "options": {}}


def test_values_have_the_names_of_the_command_line():
    assert flatten(NESTED) == {
        "seed": 3, "loss.gamma": 0.9, "loss.bc_weight.init": 1.0, "options": {},
    }  # fmt: skip


def test_groups_have_names_too():
    assert list(names(NESTED)) == [
        "seed", "loss", "loss.gamma", "loss.bc_weight", "loss.bc_weight.init", "options",
    ]  # fmt: skip


def test_a_value_is_put_where_its_name_leads():
    assert nest("seed", 3) == {"seed": 3}
    assert nest("loss.bc_weight.init", 2.0) == {"loss": {"bc_weight": {"init": 2.0}}}
    values = {"loss": {"gamma": 0.9}}
    put(values, "loss.bc_weight.init", 2.0)
    assert values == {"loss": {"gamma": 0.9, "bc_weight": {"init": 2.0}}}


def test_nothing_is_the_group_of_all():
    assert (join("", "seed"), join("loss", "gamma")) == ("seed", "loss.gamma")
