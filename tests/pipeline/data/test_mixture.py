"""The mixture: exact counts in every batch, marks that tell the truth."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict, TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from pipeline.data.buffers import (
    DemonstrationDistribution,
    EpisodeRecord,
    GrownDemonstrations,
    make_buffer,
    make_core_buffer,
)
from pipeline.data.mixture import BatchPart, Mixture
from tests.pipeline.toys import tagged_rows

MAIN, CORE, GROWN = 1.0, 2.0, 3.0


def sources(grown_rows: int = 0) -> tuple:
    main = make_buffer(50)
    main.extend(tagged_rows(MAIN, 9))
    grown = GrownDemonstrations(capacity=100)
    if grown_rows:
        grown.add(
            tagged_rows(GROWN, grown_rows), EpisodeRecord("policy", grown_rows, 0.0, True, 0.0, 0)
        )
    return main, DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 5)), grown)


def mixed(
    main: TensorDictReplayBuffer | None,
    demos: DemonstrationDistribution | None,
    *,
    main_rows: int,
    demo_rows: int,
    **options: int,
) -> Mixture:
    parts = {
        "main": BatchPart(main, main_rows),
        "demos": BatchPart(demos, demo_rows, is_demo=True),
    }
    return Mixture(parts, **options)


@settings(max_examples=40)
@given(main_rows=st.integers(0, 20), demo_rows=st.integers(0, 20), grown_rows=st.integers(0, 30))
def test_counts_are_exact_and_marks_are_true(main_rows: int, demo_rows: int, grown_rows: int):
    if main_rows + demo_rows == 0:
        return
    main, demos = sources(grown_rows)
    batch = mixed(main, demos, main_rows=main_rows, demo_rows=demo_rows).sample()
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
    mixture = mixed(main, demos, main_rows=2, demo_rows=2)
    mixture.sample()["is_demo"].fill_(False)
    assert mixture.sample()["is_demo"].sum() == 2


def test_experience_is_imitated_as_it_was_executed():
    """Core rows that say what to imitate are joined with grown and collected rows, which do not."""
    main, _ = sources()
    rows = tagged_rows(CORE, 5)
    rows["imitated_action"] = torch.full_like(rows["action"], 0.5)
    grown = GrownDemonstrations(capacity=100)
    grown.add(tagged_rows(GROWN, 5), EpisodeRecord("policy", 5, 0.0, True, 0.0, 0))
    demos = DemonstrationDistribution(make_core_buffer(rows), grown)
    batch = mixed(main, demos, main_rows=6, demo_rows=40).sample()
    core = batch["observation"][:, 0] == CORE
    assert 0 < core.sum() < 40
    assert (batch["action"] == 0).all()
    assert (batch["imitated_action"][core] == 0.5).all()
    assert (batch["imitated_action"][~core] == 0).all()
    assert "imitated_action" not in main[:]


def test_as_a_hook_it_replaces_the_collected_batch():
    main, demos = sources()
    mixture = mixed(main, demos, main_rows=3, demo_rows=1)
    assert mixture(tagged_rows(99.0, 7)).batch_size == (4,)


def test_a_source_that_is_not_asked_may_be_empty_or_missing():
    _, demos = sources()
    batch = mixed(make_buffer(5), demos, main_rows=0, demo_rows=3).sample()
    assert batch["is_demo"].all()
    main, _ = sources()
    batch = mixed(main, None, main_rows=3, demo_rows=0).sample()
    assert not batch["is_demo"].any()


@pytest.mark.parametrize(
    ("main_rows", "demo_rows", "message"),
    [
        (-1, 4, "rows of main must not be negative, got -1"),
        (4, -1, "rows of demos must not be negative, got -1"),
        (0, 0, "needs rows, but 0 are asked"),
    ],
)
def test_senseless_counts_are_named(main_rows: int, demo_rows: int, message: str):
    with pytest.raises(ValueError, match=message):
        mixed(*sources(), main_rows=main_rows, demo_rows=demo_rows)


def test_rows_of_a_missing_source_are_named_with_the_remedy():
    main, demos = sources()
    with pytest.raises(ValueError, match=r"4 rows of demos are asked .*sampler\.demo_ratio=0"):
        mixed(main, None, main_rows=4, demo_rows=4)
    with pytest.raises(ValueError, match="4 rows of main are asked"):
        mixed(None, demos, main_rows=4, demo_rows=4)


# --------------------------------------------------------------------- batches drawn together


def numbered(tags: range) -> TensorDict:
    """One row of each tag."""
    return torch.cat([tagged_rows(float(tag), 1) for tag in tags])


def tags_of(batch: TensorDictBase) -> list[float]:
    return batch["observation"][:, 0].tolist()


@settings(max_examples=40)
@given(
    draws=st.integers(1, 5),
    main_rows=st.integers(0, 6),
    demo_rows=st.integers(0, 6),
    grown_rows=st.integers(0, 9),
)
def test_each_of_the_batches_drawn_together_is_exact(
    draws: int, main_rows: int, demo_rows: int, grown_rows: int
):
    if main_rows + demo_rows == 0:
        return
    main, demos = sources(grown_rows)
    mixture = mixed(main, demos, main_rows=main_rows, demo_rows=demo_rows, draws=draws)
    for _ in range(2 * draws + 1):
        batch = mixture.sample()
        assert batch.batch_size == (main_rows + demo_rows,)
        from_demos = [tag != MAIN for tag in tags_of(batch)]
        assert from_demos == [False] * main_rows + [True] * demo_rows
        assert batch["is_demo"].tolist() == [[mark] for mark in from_demos]
        assert torch.equal(batch["observation"][:, :1], batch["next", "reward"])


def test_the_sources_are_asked_once_for_all_batches_of_a_draw(monkeypatch: pytest.MonkeyPatch):
    main, demos = sources()
    asked = []
    sample = main.sample
    monkeypatch.setattr(main, "sample", lambda rows: asked.append(rows) or sample(rows))
    mixture = mixed(main, demos, main_rows=3, demo_rows=1, draws=4)
    for _ in range(4):
        mixture.sample()
    assert asked == [12]
    mixture.sample()
    assert asked == [12, 12]


def test_batches_drawn_together_do_not_share_their_entries():
    main, demos = sources()
    mixture = mixed(main, demos, main_rows=2, demo_rows=2, draws=3)
    first = mixture.sample()
    first["observation"].fill_(99.0)
    first["is_demo"].fill_(True)
    for _ in range(4):  # the rest of this draw, and the next one
        batch = mixture.sample()
        assert tags_of(batch) == [MAIN, MAIN, CORE, CORE]
        assert batch["is_demo"].squeeze(-1).tolist() == [False, False, True, True]


def changing(draws: int) -> tuple[Mixture, Callable[[float], object]]:
    """A mixture over one row, and what replaces that row by another."""
    main = make_buffer(1)
    main.extend(tagged_rows(1.0, 1))
    mixture = mixed(main, None, main_rows=2, demo_rows=0, draws=draws)
    return mixture, lambda tag: main.extend(tagged_rows(tag, 1))


def test_renewing_throws_away_what_was_drawn_before():
    mixture, replace = changing(draws=3)
    assert tags_of(mixture.sample()) == [1.0, 1.0]
    replace(2.0)
    assert tags_of(mixture.sample()) == [1.0, 1.0]  # drawn together with the first
    mixture.renew()
    assert tags_of(mixture.sample()) == [2.0, 2.0]


def test_a_collected_batch_renews_the_draw_once():
    mixture, replace = changing(draws=3)
    first, second = tagged_rows(7.0, 1), tagged_rows(7.0, 1)
    assert tags_of(mixture(first)) == [1.0, 1.0]
    replace(2.0)
    assert tags_of(mixture(first)) == [1.0, 1.0]  # the same collected batch: the draw serves on
    assert tags_of(mixture(second)) == [2.0, 2.0]
    replace(3.0)
    assert [tags_of(mixture(second)) for _ in range(3)] == [[2.0] * 2, [2.0] * 2, [3.0] * 2]


def test_single_draws_always_see_the_sources_as_they_are():
    mixture, replace = changing(draws=1)
    for tag in (2.0, 3.0):
        replace(tag)
        assert tags_of(mixture.sample()) == [tag, tag]


@pytest.mark.parametrize("draws", [0, -2])
def test_too_few_draws_are_named(draws: int):
    with pytest.raises(ValueError, match=rf"draws must be at least 1, got {draws}\."):
        mixed(*sources(), main_rows=1, demo_rows=1, draws=draws)


def test_rows_are_drawn_uniformly_whatever_batch_and_place_they_come_to():
    """8 main and 4 core rows, batches of 3 + 2; chi squared against uniform counts."""
    main = make_buffer(20)
    main.extend(numbered(range(8)))
    demos = DemonstrationDistribution(make_core_buffer(numbered(range(8, 12))))
    mixture = mixed(main, demos, main_rows=3, demo_rows=2, draws=16)
    batches = [mixture.sample() for _ in range(4000)]
    tags = torch.stack([batch["observation"][:, 0] for batch in batches]).long()
    assert len({tuple(row) for row in tags[:16].tolist()}) == 16
    for place in range(5):
        # By place in the batch, and by the batch's place in its draw, first and last.
        for chosen in (tags[:, place], tags[::16, place], tags[15::16, place]):
            counts = torch.bincount(chosen, minlength=12)
            counts = counts[:8] if place < 3 else counts[8:]
            assert counts.sum() == len(chosen)
            expected = len(chosen) / len(counts)
            statistic = float(((counts - expected) ** 2 / expected).sum())
            # Quantiles of chi squared at 1 - 1e-4: 29.9 for 7 degrees of freedom, 21.1 for 3.
            assert statistic < (29.9 if place < 3 else 21.1)


def test_batches_of_a_draw_do_not_repeat_one_another():
    """Neighbouring batches agree in a row as often as chance has it: one in eight."""
    main = make_buffer(20)
    main.extend(numbered(range(8)))
    mixture = mixed(main, None, main_rows=4, demo_rows=0, draws=16)
    tags = torch.stack([mixture.sample()["observation"][:, 0] for _ in range(2000)])
    agreeing = (tags[1:] == tags[:-1]).float().mean().item()
    # The standard error is sqrt(1/8 * 7/8 / 7996) < 0.004.
    assert agreeing == pytest.approx(1 / 8, abs=0.016)


# --------------------------------------------------------------------------- further sources


@pytest.mark.parametrize(
    ("seed", "draws", "rows", "grown_rows", "share", "batches", "then"),
    [
        (0, 1, (4, 2), 0, None,
         [[4, 39, 13, 0, 43, 59], [27, 23, 17, 3, 41, 46], [36, 39, 38, 16, 56, 48]], 868794),
        (1, 3, (3, 2), 12, None,
         [[11, 21, 39, 56, 60], [8, 23, 33, 49, 61], [5, 19, 4, 48, 71]], 103302),
        (2, 2, (0, 5), 12, 0.5,
         [[58, 59, 42, 63, 66], [47, 41, 44, 67, 68], [43, 59, 47, 64, 60]], 647973),
        (3, 16, (2, 3), 20, 0.3,
         [[10, 31, 52, 44, 69], [14, 10, 43, 50, 65], [17, 34, 52, 44, 69]], 79159),
        (4, 2, (5, 0), 0, None,
         [[16, 39, 16, 2, 1], [10, 14, 31, 13, 9], [7, 7, 33, 0, 12]], 424178),
    ],
)  # fmt: skip
def test_main_and_demonstrations_are_drawn_as_when_there_were_no_others(
    seed: int,
    draws: int,
    rows: tuple[int, int],
    grown_rows: int,
    share: float | None,
    batches: list[list[int]],
    then: int,
):
    """Rows, and the next random number, as the mixture of exactly these two drew them."""
    main = make_buffer(50)
    main.extend(numbered(range(40)))
    grown = GrownDemonstrations(capacity=20)
    if grown_rows:
        record = EpisodeRecord("policy", grown_rows, 0.0, True, 0.0, 0)
        grown.add(numbered(range(60, 60 + grown_rows)), record)
    core = make_core_buffer(numbered(range(40, 60)))
    demos = DemonstrationDistribution(core, grown if grown_rows else None, share)
    torch.manual_seed(seed)
    mixture = mixed(main, demos, main_rows=rows[0], demo_rows=rows[1], draws=draws)
    assert [tags_of(mixture.sample()) for _ in range(3)] == batches
    assert torch.randint(10**6, ()).item() == then


class Counting:
    """Rows ``first``, ``first + 1``, ..., without the places that a buffer's rows have."""

    def __init__(self, first: int) -> None:
        self.next = first

    def sample(self, count: int) -> TensorDict:
        found = numbered(range(self.next, self.next + count))
        self.next += count
        return found


def test_demonstrations_come_last_and_each_batch_has_its_own_rows_of_every_source():
    main, demos = sources()
    parts = {
        "first": BatchPart(Counting(100), 2, is_demo=True),
        "main": BatchPart(main, 3),
        "second": BatchPart(Counting(200), 2),
        "demos": BatchPart(demos, 1, is_demo=True),
        "third": BatchPart(Counting(300), 0, is_demo=True),
    }
    mixture = Mixture(parts, draws=2)
    batches = [mixture.sample(), mixture.sample()]
    assert sorted(map(tags_of, batches)) == [
        [MAIN, MAIN, MAIN, 200.0, 201.0, 100.0, 101.0, CORE],
        [MAIN, MAIN, MAIN, 202.0, 203.0, 102.0, 103.0, CORE],
    ]
    for batch in batches:
        assert batch["is_demo"].squeeze(-1).tolist() == [False] * 5 + [True] * 3
        assert (batch["index"] >= 0).tolist() == [True] * 3 + [False] * 4 + [True]
