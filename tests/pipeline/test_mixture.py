"""The mixture: exact counts in every batch, marks that tell the truth."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.buffers import (
    DemonstrationDistribution,
    EpisodeRecord,
    GrownDemonstrations,
    make_buffer,
    make_core_buffer,
)
from pipeline.mixture import Mixture
from tests.pipeline.toys import tagged_rows

MAIN, CORE, GROWN = 1.0, 2.0, 3.0


def sources(grown_rows: int = 0) -> tuple:
    main = make_buffer(50)
    main.extend(tagged_rows(MAIN, 9))
    grown = GrownDemonstrations(capacity=100)
    if grown_rows:
        grown.add(tagged_rows(GROWN, grown_rows), EpisodeRecord("policy", grown_rows, 0.0, 0.0, 0))
    return main, DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 5)), grown)


@settings(max_examples=40, deadline=None)
@given(main_rows=st.integers(0, 20), demo_rows=st.integers(0, 20), grown_rows=st.integers(0, 30))
def test_counts_are_exact_and_marks_are_true(main_rows: int, demo_rows: int, grown_rows: int):
    if main_rows + demo_rows == 0:
        return
    main, demos = sources(grown_rows)
    batch = Mixture(main, demos, main_rows=main_rows, demo_rows=demo_rows).sample()
    assert batch.batch_size == (main_rows + demo_rows,)
    from_demos = batch["observation"][:, 0] != MAIN
    assert int(from_demos.sum()) == demo_rows
    assert batch["is_demo"].shape == (main_rows + demo_rows, 1)
    assert batch["is_demo"].dtype == torch.bool
    assert torch.equal(batch["is_demo"].squeeze(-1), from_demos)
    # A row's entries stay together.
    assert torch.equal(batch["observation"][:, :1], batch["next", "reward"])


def test_the_marks_of_one_batch_are_not_those_of_the_next():
    main, demos = sources()
    mixture = Mixture(main, demos, main_rows=2, demo_rows=2)
    mixture.sample()["is_demo"].fill_(False)
    assert mixture.sample()["is_demo"].sum() == 2


def test_as_a_hook_it_replaces_the_collected_batch():
    main, demos = sources()
    mixture = Mixture(main, demos, main_rows=3, demo_rows=1)
    assert mixture(tagged_rows(99.0, 7)).batch_size == (4,)


def test_a_source_that_is_not_asked_may_be_empty_or_missing():
    _, demos = sources()
    batch = Mixture(make_buffer(5), demos, main_rows=0, demo_rows=3).sample()
    assert batch["is_demo"].all()
    main, _ = sources()
    batch = Mixture(main, None, main_rows=3, demo_rows=0).sample()
    assert not batch["is_demo"].any()


@pytest.mark.parametrize(
    ("main_rows", "demo_rows", "message"),
    [
        (-1, 4, "main_rows must not be negative, got -1"),
        (4, -1, "demo_rows must not be negative, got -1"),
        (0, 0, "needs rows, but 0 are asked"),
    ],
)
def test_senseless_counts_are_named(main_rows: int, demo_rows: int, message: str):
    with pytest.raises(ValueError, match=message):
        Mixture(*sources(), main_rows=main_rows, demo_rows=demo_rows)


def test_rows_of_a_missing_source_are_named_with_the_remedy():
    main, demos = sources()
    with pytest.raises(ValueError, match=r"4 demo rows are asked .* \(sampler\.demo_ratio=0\)"):
        Mixture(main, None, main_rows=4, demo_rows=4)
    with pytest.raises(ValueError, match="4 main rows are asked"):
        Mixture(None, demos, main_rows=4, demo_rows=4)
