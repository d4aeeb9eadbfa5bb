"""Updates that are recorded and replayed are the ordinary ones.

Where there is no GPU, TorchRL's graphs call what they should record, so that these tests hold the
surroundings together; where there is one, they compare replays with eager updates.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from losses import GradientRatio
from pipeline.learn.imitation import ImitationStepper
from pipeline.machine import cuda_graphs
from pipeline.machine.cuda_graphs import CudaGraphs
from tests.pipeline.toys import make_batch
from tests.pipeline.updating import (
    UPDATES,
    learnt,
    make_loss,
    make_stepper,
    marked,
    marked_and_unmarked,
)

pytestmark = [
    pytest.mark.filterwarnings("ignore:This module is instantiated on a machine without"),
    # The recorded rates are float32 all the same.
    pytest.mark.usefixtures("float64"),
]

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def close(found: object, expected: object) -> None:
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-7, equal_nan=True)


def batches(count: int) -> list[TensorDict]:
    return [batch.to(DEVICE) for batch in marked_and_unmarked(count)]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rl_on_demos": True, "target_subset": 2},
        {"q_filter": True},
    ],
)
@pytest.mark.parametrize(
    ("rule", "training"), [(None, {}), (GradientRatio(0.5), {"max_grad_norm": 1.0})]
)
def test_replayed_updates_are_the_ordinary_ones(
    options: dict, rule: GradientRatio | None, training: dict
):
    plain = make_loss(DEVICE, bc_rule=rule, **options)
    graphs = deepcopy(plain)
    given = batches(UPDATES)
    expected = learnt(plain, make_stepper(plain, **training), given)
    found = learnt(graphs, make_stepper(graphs, cuda_graphs=True, **training), given)
    close(found, expected)
    start = make_loss(DEVICE, **options).log_alpha
    assert (found[0]["log_alpha"] - start).abs() > 1e-3


def test_replayed_updates_are_the_ordinary_ones_in_bfloat16():
    torch.set_default_dtype(torch.float32)
    plain = make_loss(DEVICE, hidden_dtype=torch.bfloat16)
    graphs = deepcopy(plain)
    given = batches(10)
    expected, *_ = learnt(plain, make_stepper(plain), given)
    found, *_ = learnt(graphs, make_stepper(graphs, cuda_graphs=True), given)
    # Ten steps of 0.001 to 0.003: a step in the wrong direction is farther away than this.
    torch.testing.assert_close(found, expected, rtol=0, atol=5e-4)


def test_replayed_imitation_is_the_ordinary_one():
    plain = make_loss(DEVICE)
    graphs = deepcopy(plain)
    given = [make_batch(6, 6).to(DEVICE) for _ in range(UPDATES)]
    options = {"actor_lr": 1e-3, "anneal_updates": UPDATES}
    expected = learnt(plain, ImitationStepper(plain, **options), given)
    found = learnt(graphs, ImitationStepper(graphs, cuda_graphs=True, **options), given)
    close(found, expected)


@pytest.mark.parametrize(("before", "after"), [(True, True), (True, False), (False, True)])
def test_a_run_goes_on_with_or_without_recordings(before: bool, after: bool):
    whole = make_loss(DEVICE)
    halved = deepcopy(whole)
    given = batches(UPDATES)
    expected, *_ = learnt(whole, make_stepper(whole), given)
    torch.manual_seed(3)
    first = make_stepper(halved, cuda_graphs=before)
    for batch in given[:11]:
        first.step(None, batch.clone())
    state = first.state_dict()
    # As a checkpoint brings it: on the CPU.
    state = torch.utils._pytree.tree_map_only(Tensor, lambda t: t.detach().cpu().clone(), state)
    second = make_stepper(halved, cuda_graphs=after)
    second.load_state_dict(state)
    groups = [group for opt in second.optimizers.values() for group in opt.param_groups]
    assert {group["capturable"] for group in groups} == {after}
    assert {isinstance(group["lr"], Tensor) for group in groups} == {after}
    for batch in given[11:]:
        second.step(None, batch.clone())
    close(dict(halved.named_parameters()), expected)


@pytest.mark.parametrize("make", [make_stepper, partial(ImitationStepper, actor_lr=1e-3)])
def test_what_was_recorded_before_a_state_is_loaded_is_recorded_anew(make):
    """Loading puts other moments and rates in place of those that a recording reads."""
    given = marked(8) if make is make_stepper else [make_batch(6, 6) for _ in range(8)]
    given = [batch.to(DEVICE) for batch in given]
    whole = make_loss(DEVICE)
    first = make(whole, cuda_graphs=True)
    learnt(whole, first, given[:4])
    weights, state = deepcopy(whole.state_dict()), deepcopy(first.state_dict())
    expected = learnt(whole, first, given[4:])
    made = []
    for used in (True, False):
        loss = make_loss(DEVICE)
        stepper = make(loss, cuda_graphs=True)
        if used:
            learnt(loss, stepper, given)
        loss.load_state_dict(weights)
        stepper.load_state_dict(deepcopy(state))  # it is gone on with, not copied
        with counted_recordings() as recordings:
            found = learnt(loss, stepper, given[4:])
        close(found, expected)
        made.append(len(recordings))
    # As many as by one that never recorded anything.
    assert made[0] == made[1] > 0


@contextmanager
def counted_recordings() -> Iterator[list[object]]:
    made: list[object] = []
    original = cuda_graphs._Recording.__init__

    def counting(self: object, update: object) -> None:
        made.append(update)
        original(self, update)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cuda_graphs._Recording, "__init__", counting)
        yield made


def test_each_layout_of_batch_has_its_own_recording():
    def count(batch: TensorDictBase) -> dict[str, Tensor]:
        return {
            "rows": torch.full((), float(batch.numel()), device=DEVICE),
            "sum": batch["x"].sum(),
        }

    counted = CudaGraphs(count)
    for _ in range(4):
        for rows in (3, 5):
            batch = TensorDict({"x": torch.randn(rows)}, [rows], device=DEVICE)
            found = counted(batch)
            assert found["rows"] == rows
            assert found["sum"] == batch["x"].sum()
            marked = counted(batch.set("is_demo", torch.ones(rows, 1, device=DEVICE)))
            assert marked == found
    assert len(counted._recordings) == 4


def test_results_are_not_overwritten_by_the_next_replay():
    summed = CudaGraphs(lambda batch: {"sum": batch["x"].sum(), "first": batch["x"][0]})
    given = [TensorDict({"x": torch.randn(3)}, [3], device=DEVICE) for _ in range(6)]
    found = [summed(batch.clone()) for batch in given]
    for batch, results in zip(given, found, strict=True):
        assert results == {"sum": batch["x"].sum(), "first": batch["x"][0]}
