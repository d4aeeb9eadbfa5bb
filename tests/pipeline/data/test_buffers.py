"""The demonstration buffers: what may change, what leaves first, who gets which share."""

from __future__ import annotations

import math

import pytest
import torch

from pipeline.data.buffers import (
    DemonstrationDistribution,
    EpisodeRecord,
    GrownDemonstrations,
    make_buffer,
    make_core_buffer,
)
from tests.pipeline.toys import tagged_rows

CORE, GROWN = 1.0, 2.0


def record(length: int, frame: int = 0, **changes) -> EpisodeRecord:
    fields = {
        "source": "policy",
        "episode_return": 5.0,
        "success": True,
        "max_progress": 1.5,
    } | changes
    return EpisodeRecord(length=length, frame=frame, **fields)


def tags(rows) -> set[float]:
    return set(rows["observation"][:, 0].tolist())


def test_the_core_holds_exactly_the_rows_it_was_given():
    rows = torch.cat([tagged_rows(tag, 1) for tag in (1.0, 2.0, 3.0)])
    core = make_core_buffer(rows)
    assert len(core) == 3
    assert tags(core.sample(200)) == {1.0, 2.0, 3.0}


def test_the_core_cannot_be_written_to():
    core = make_core_buffer(tagged_rows(CORE, 4))
    with pytest.raises(RuntimeError, match="doesn't allow writing"):
        core.extend(tagged_rows(GROWN, 1))
    assert tags(core.sample(50)) == {CORE}


@pytest.mark.parametrize("kind", ["core", "main"])
def test_buffers_own_their_rows(kind: str):
    """A change of the source after storing must not reach the buffer."""
    rows = tagged_rows(CORE, 4)
    if kind == "core":
        buffer = make_core_buffer(rows)
    else:
        buffer = make_buffer(10)
        buffer.extend(rows)
    rows.apply_(lambda tensor: tensor.fill_(math.nan) if tensor.is_floating_point() else tensor)
    assert buffer.sample(20)["observation"].isfinite().all()
    assert buffer.sample(20)["next", "reward"].isfinite().all()


def test_a_change_of_a_sample_does_not_reach_the_buffer():
    buffer = make_core_buffer(tagged_rows(CORE, 4))
    buffer.sample(4)["observation"].fill_(math.nan)
    assert buffer.sample(20)["observation"].isfinite().all()


def test_no_demonstrations_are_refused():
    with pytest.raises(ValueError, match=r"no transitions; check demos\.source"):
        make_core_buffer(tagged_rows(CORE, 0))


def test_the_oldest_grown_episode_leaves_first_and_takes_its_record_along():
    grown = GrownDemonstrations(capacity=10)
    for tag in (1.0, 2.0):
        grown.add(tagged_rows(tag, 4), record(4, frame=int(tag)))
    assert [r.frame for r in grown.records] == [1, 2]
    grown.add(tagged_rows(3.0, 4), record(4, frame=3))
    assert [r.frame for r in grown.records] == [2, 3]
    # The ring still holds the two oldest rows' places that no newer episode has needed.
    assert len(grown) == 10
    kept = grown.buffer[:]["observation"][:, 0].tolist()
    assert sorted(kept) == [1.0] * 2 + [2.0] * 4 + [3.0] * 4


def test_an_episode_that_fits_exactly_stays():
    grown = GrownDemonstrations(capacity=8)
    grown.add(tagged_rows(1.0, 4), record(4))
    grown.add(tagged_rows(2.0, 4), record(4))
    assert len(grown.records) == 2


def test_an_episode_longer_than_the_ring_is_refused():
    with pytest.raises(ValueError, match=r"5 rows does not fit in growth\.capacity=4"):
        GrownDemonstrations(capacity=4).add(tagged_rows(1.0, 5), record(5))


def test_records_survive_a_round_trip():
    grown = GrownDemonstrations(capacity=10)
    grown.add(tagged_rows(1.0, 3), record(3, frame=7, episode_return=-2.5))
    grown.add(tagged_rows(1.0, 2), record(2, frame=9, source="bc_model"))
    restored = GrownDemonstrations(capacity=10)
    restored.load_state_dict(grown.state_dict())
    assert restored.records == grown.records
    # Still the ring's bookkeeping, not just a list.
    restored.add(tagged_rows(2.0, 8), record(8, frame=11))
    assert [r.frame for r in restored.records] == [9, 11]


@pytest.mark.parametrize("n", [1, 7, 64])
def test_d_gives_exactly_n_rows(n: int):
    grown = GrownDemonstrations(capacity=100)
    d = DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 30)), grown)
    assert len(d) == 30
    assert d.sample(n).batch_size == (n,)
    grown.add(tagged_rows(GROWN, 10), record(10))
    assert len(d) == 40
    assert all(d.sample(n).batch_size == (n,) for _ in range(20))


def test_the_grown_part_gets_its_share_on_average():
    """10 rows of 40, batches of 5: 1.25 rows each, so 1 or 2 and neither always."""
    grown = GrownDemonstrations(capacity=100)
    grown.add(tagged_rows(GROWN, 10), record(10))
    d = DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 30)), grown)
    counts = [int((d.sample(5)["observation"][:, 0] == GROWN).sum()) for _ in range(2000)]
    assert set(counts) == {1, 2}
    # The standard error is sqrt(0.25 * 0.75 / 2000) < 0.01.
    assert sum(counts) / 2000 == pytest.approx(1.25, abs=0.04)


@pytest.mark.parametrize(("grown_rows", "expected"), [(0, 0.0), (25, 1.5), (100, 6.0)])
def test_a_share_of_the_grown_part_comes_with_its_rows(grown_rows: int, expected: float):
    """0.6 of batches of 10 once its 100 rows are there, whatever the size of the core."""
    grown = GrownDemonstrations(capacity=100)
    if grown_rows:
        grown.add(tagged_rows(GROWN, grown_rows), record(grown_rows))
    core = make_core_buffer(tagged_rows(CORE, 3000))
    d = DemonstrationDistribution(core, grown, grown_share=0.6)
    counts = (d.sample_batches(2000, 10)["observation"][..., 0] == GROWN).sum(-1)
    single = [int((d.sample(10)["observation"][:, 0] == GROWN).sum()) for _ in range(2000)]
    # The standard error is at most sqrt(0.25 / 2000) < 0.012.
    assert sum(single) / 2000 == pytest.approx(expected, abs=0.045)
    assert len(counts.unique()) == 1
    assert counts[0].item() in (math.floor(expected), math.ceil(expected))


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_share_out_of_range_is_refused(share: float):
    with pytest.raises(ValueError, match=r"growth\.share must be in \[0, 1\] or null"):
        DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 3)), grown_share=share)


@pytest.mark.parametrize(("batches", "n"), [(1, 5), (4, 5), (3, 1)])
@pytest.mark.parametrize("grown_rows", [None, 0, 10])
def test_batches_of_d_have_n_rows_each_the_core_s_first(
    batches: int, n: int, grown_rows: int | None
):
    grown = None if grown_rows is None else GrownDemonstrations(capacity=100)
    if grown is not None and grown_rows:
        grown.add(tagged_rows(GROWN, grown_rows), record(grown_rows))
    d = DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 30)), grown)
    for _ in range(10):
        drawn = d.sample_batches(batches, n)
        assert drawn.batch_size == (batches, n)
        from_grown = drawn["observation"][..., 0] == GROWN
        assert torch.equal(from_grown, from_grown.sort(dim=1).values)
        assert from_grown.any().item() <= bool(grown_rows)
        # A row's entries stay together.
        assert torch.equal(drawn["observation"][..., :1], drawn["next", "reward"])


@pytest.mark.parametrize("grown_rows", [10, 270])
def test_the_grown_part_s_share_is_exact_on_average_in_every_batch(grown_rows: int):
    """10 rows of 40 make 1.25 of 5; 270 of 300 make 4.5 of 5. The rounding is the draw's."""
    grown = GrownDemonstrations(capacity=1000)
    grown.add(tagged_rows(GROWN, grown_rows), record(grown_rows))
    d = DemonstrationDistribution(make_core_buffer(tagged_rows(CORE, 30)), grown)
    expected = 5 * grown_rows / (grown_rows + 30)
    drawn = [d.sample_batches(3, 5)["observation"][..., 0] == GROWN for _ in range(2000)]
    counts = torch.stack(drawn).sum(-1)  # [2000, 3]
    assert set(counts.unique().tolist()) == {math.floor(expected), math.ceil(expected)}
    # The standard error is at most sqrt(0.25 / 2000) < 0.012.
    for mean in counts.double().mean(0).tolist():
        assert mean == pytest.approx(expected, abs=0.045)


def test_batches_of_d_drawn_together_are_draws_of_their_own():
    """Neighbouring batches agree in a row as often as chance has it: one in ten."""
    d = DemonstrationDistribution(
        make_core_buffer(torch.cat([tagged_rows(float(tag), 1) for tag in range(10)]))
    )
    drawn = d.sample_batches(1000, 5)["observation"][..., 0]
    # The standard error is sqrt(0.1 * 0.9 / 4995) < 0.0043.
    assert (drawn[1:] == drawn[:-1]).float().mean().item() == pytest.approx(0.1, abs=0.018)


def test_a_sample_is_what_its_positions_say():
    buffer = make_buffer(8)
    for tag in range(5):  # the ring is not full
        buffer.extend(tagged_rows(float(tag), 1))
    sample = buffer.sample(64)
    assert tags(sample) == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert torch.equal(sample["observation"][:, 0], sample["index"].float())


def test_rows_are_read_by_whatever_indexes_a_tensor():
    buffer = make_buffer(8)
    buffer.extend(torch.cat([tagged_rows(float(tag), 1) for tag in range(5)]))
    mask = torch.tensor([True, False, False, True, False])
    get = buffer.storage.get
    assert tags(get(mask)) == {0.0, 3.0}
    assert tags(get(slice(1, 3))) == {1.0, 2.0}
    assert tags(get(torch.tensor([[1, 2], [4, 4]])).flatten()) == {1.0, 2.0, 4.0}
    assert float(get(2)["observation"][0]) == 2.0
    with pytest.raises(IndexError):
        get(torch.tensor([5]))
