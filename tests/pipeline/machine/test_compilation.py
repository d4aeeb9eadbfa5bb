"""Compiled updates are the ordinary ones, and leave no trace in the random numbers.

Both sides compute in float64, where rounding does not grow over the updates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch._dynamo.utils import counters
from torch._inductor.utils import fresh_cache
from torch.fx.experimental.proxy_tensor import make_fx

from losses import BCSACLoss, GradientRatio
from pipeline.learn.imitation import ImitationStepper
from pipeline.learn.optimizers import AdamStep, make_adam, set_recordable
from pipeline.machine.compilation import Compiled, _compute_once, compiled, why_not_compiled
from tests.pipeline.resuming import differences, everything, whole_and_halved
from tests.pipeline.toys import make_batch
from tests.pipeline.updating import (
    UPDATES,
    learnt,
    make_loss,
    make_stepper,
    marked,
    marked_and_unmarked,
)

needs_compiler = pytest.mark.skipif(
    why_not_compiled() is not None, reason=f"cannot compile here: {why_not_compiled()}"
)

RATIO = GradientRatio(0.5)


def close(found: object, expected: object) -> None:
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9, equal_nan=True)


@needs_compiler
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize(
    ("options", "training", "batches"),
    [
        ({}, {}, marked_and_unmarked),
        # Two kinds of draws in one update, whose order is part of a run.
        (
            {"rl_on_demos": True, "target_subset": 2, "q_filter": True, "bc_rule": RATIO},
            {"max_grad_norm": 1.0, "target_period": 1},
            marked,
        ),
    ],
    ids=["plain", "options"],
)
def test_compiled_updates_are_the_ordinary_ones(options: dict, training: dict, batches):
    plain = make_loss(**options)
    fast = deepcopy(plain)
    given = batches(UPDATES)
    expected = learnt(plain, make_stepper(plain, **training), given)
    found = learnt(fast, make_stepper(fast, **training, compile_updates=True), given)
    close(found, expected)
    start = make_loss(**options).log_alpha
    assert (found[0]["log_alpha"] - start).abs() > 1e-3


@needs_compiler
def test_compiled_updates_are_the_ordinary_ones_in_bfloat16():
    plain = make_loss(hidden_dtype=torch.bfloat16)
    fast = deepcopy(plain)
    given = marked(10)
    start = weights_of(plain)
    learnt(plain, make_stepper(plain), given)
    learnt(fast, make_stepper(fast, compile_updates=True), given)
    # The compiled sums of several operations are rounded once, not after each: near zero, where
    # Adam's step has its size all the same, a gradient may turn.
    way = (weights_of(plain) - start).norm()
    assert (weights_of(fast) - weights_of(plain)).norm() < 0.1 * way


def weights_of(loss: BCSACLoss) -> Tensor:
    return torch.nn.utils.parameters_to_vector(loss.parameters()).detach().clone()


@needs_compiler
@pytest.mark.usefixtures("float64")
def test_compiled_imitation_is_the_ordinary_one():
    plain = make_loss()
    fast = deepcopy(plain)
    given = [make_batch(6, 6) for _ in range(UPDATES)]
    options = {"actor_lr": 1e-3, "anneal_updates": UPDATES}
    expected = learnt(plain, ImitationStepper(plain, **options), given)
    found = learnt(fast, ImitationStepper(fast, **options, compile_updates=True), given)
    close(found, expected)


@needs_compiler
@pytest.mark.usefixtures("float64")
def test_a_loaded_state_is_gone_on_from():
    """Updates were compiled before on the moments and rates of another."""
    loss = make_loss()
    first = make_stepper(loss, compile_updates=True)
    given = marked(6)
    learnt(loss, first, given[:3])
    weights, state = deepcopy(loss.state_dict()), deepcopy(first.state_dict())
    expected = learnt(loss, first, given[3:])
    second_loss = make_loss()
    second = make_stepper(second_loss, compile_updates=True)
    learnt(second_loss, second, marked(4))
    second_loss.load_state_dict(weights)
    second.load_state_dict(state)
    found = learnt(second_loss, second, given[3:])
    torch.testing.assert_close(found, expected, rtol=0.0, atol=0.0, equal_nan=True)


@needs_compiler
@pytest.mark.usefixtures("float64")
def test_tracing_leaves_nothing_behind():
    loss = make_loss()
    stepper = make_stepper(loss, compile_updates=True)
    for batch in marked(5):
        stepper.step(None, batch)
    # The actor's last update may be one that is taken apart, which is not compiled.
    assert all(parameter.grad is None for parameter in loss.critic.parameters())
    counts = {s["step"].item() for s in stepper.optimizers["critic"].state.values()}
    assert counts == {5.0}


@needs_compiler
def test_each_layout_of_batch_is_compiled_once(monkeypatch: pytest.MonkeyPatch):
    traced = []

    def count(batch: TensorDictBase) -> dict[str, Tensor]:
        traced.append(batch.batch_size)
        return {"rows": torch.full((), float(batch.numel())), "double": batch["x"] * 2}

    counted = Compiled(count)
    for _ in range(3):
        for rows in (3, 5):
            batch = TensorDict({"x": torch.randn(rows)}, [rows])
            found = counted(batch)
            assert found["rows"] == rows
            assert torch.equal(found["double"], 2 * batch["x"])
    assert traced == [torch.Size([3]), torch.Size([5])]


@needs_compiler
def test_what_one_run_compiled_serves_the_next(entries: Callable[[], tuple[int, int]]):
    """With the numbers of the next: those that the update finds outside of batch and state."""

    def scaled_by(scale: Tensor) -> Compiled:
        return Compiled(lambda batch: {"scaled": batch["x"] * scale})

    batch = TensorDict({"x": torch.ones(3)}, [3])
    for run, size in enumerate([2.0, 5.0]):
        scale = torch.full((3,), size)
        scaled = scaled_by(scale)
        assert scaled(batch)["scaled"].tolist() == [size] * 3
        scale.fill_(7.0)
        assert scaled(batch)["scaled"].tolist() == [7.0] * 3
        assert entries() == (1, run)


@needs_compiler
def test_batches_of_another_order_of_keys_are_not_compiled_anew(
    entries: Callable[[], tuple[int, int]],
):
    def update(batch: TensorDictBase) -> dict[str, Tensor]:
        return {"difference": batch["x"] - batch["next", "x"]}

    values = {"x": torch.tensor([5.0]), "next": {"x": torch.tensor([2.0])}}
    for names in (["x", "next"], ["next", "x"]):
        batch = TensorDict({name: values[name] for name in names}, [1])
        assert Compiled(update)(batch)["difference"].item() == 3.0
    assert entries() == (1, 1)


@needs_compiler
def test_loops_that_were_split_among_other_threads_are_compiled_anew(
    entries: Callable[[], tuple[int, int]],
):
    batch = TensorDict({"x": torch.ones(100_000)}, [])
    threads = torch.get_num_threads()
    try:
        for count in (1, 2, 1):
            torch.set_num_threads(count)
            Compiled(lambda batch: {"sum": batch["x"].sum()})(batch)
    finally:
        torch.set_num_threads(threads)
    assert entries() == (2, 1)


@pytest.fixture
def entries() -> Iterator[Callable[[], tuple[int, int]]]:
    """How many graphs were compiled and how many were found, in a cache that is empty at first."""
    before = Counter(counters["inductor"])

    def count() -> tuple[int, int]:
        # The first compilation of a process puts another counter in its place.
        now = counters["inductor"] - before
        return now["fxgraph_cache_miss"], now["fxgraph_cache_hit"]

    with fresh_cache():
        yield count


@needs_compiler
def test_what_cannot_be_called_from_cpp_is_called_from_python():
    """So is a permutation with a generator, in torch 2.13."""

    def ranked(batch: TensorDictBase) -> dict[str, Tensor]:
        return {"ranked": batch["x"] * torch.randperm(5, generator=None)}

    batch = TensorDict({"x": torch.randn(5)}, [5])
    torch.manual_seed(3)
    found = Compiled(ranked)(batch)
    torch.manual_seed(3)
    assert torch.equal(found["ranked"], ranked(batch)["ranked"])


@needs_compiler
@pytest.mark.parametrize("scales", [{}, {"beta": 0.5, "alpha": 3.0}], ids=["plain", "scaled"])
def test_a_bias_apart_from_its_product_is_added_once(scales: dict[str, float]):
    bias, left, right = torch.randn(4), torch.randn(6, 3), torch.randn(3, 4)

    def both(batch: TensorDictBase) -> dict[str, Tensor]:
        rows = batch["x"]
        members = torch.baddbmm(bias, rows.expand(2, -1, -1), right.expand(2, -1, -1), **scales)
        return {"one": torch.addmm(bias, rows, right, **scales), "members": members}

    batch = TensorDict({"x": left}, [6])
    torch.testing.assert_close(Compiled(both)(batch), both(batch))


@needs_compiler
def test_the_first_steps_of_adam_have_their_size():
    """Of 1 - 0.999 in float32 only four digits are right."""
    slow, fast = (nn.Parameter(torch.linspace(-1.0, 1.0, 8)) for _ in range(2))
    start = slow.detach().clone()
    steps = [AdamStep(make_adam([([parameter], 1e-2)])) for parameter in (slow, fast)]

    def update(parameter: nn.Parameter, step: AdamStep, batch: TensorDictBase) -> dict[str, Tensor]:
        parameter.grad = batch["gradient"]
        step()
        return {}

    ordinary = partial(update, slow, steps[0])
    quick = Compiled(partial(update, fast, steps[1]), steps[1].state)
    for _ in range(3):
        batch = TensorDict({"gradient": torch.randn(8)})
        ordinary(batch)
        quick(batch)
        # A parameter of size 1 is known to 6e-8, and has moved by 0.01.
        torch.testing.assert_close(fast - start, slow - start, rtol=0.0, atol=1.3e-7)


def test_shared_numbers_have_their_place_in_memory():
    def function(rows: Tensor, rate: Tensor) -> Tensor:
        scale = rows.square().mean(1, keepdim=True).rsqrt()
        known = rows.new_ones(()).expand_as(rows)
        return rows * scale * (2.0 * rate) + known

    rows, rate = torch.randn(3, 4), torch.tensor(0.1)
    graph = make_fx(function)(rows, rate)
    _compute_once(graph.graph)
    graph.recompile()
    torch.testing.assert_close(graph(rows, rate), function(rows, rate))
    shared = {
        node.args[0].target
        for node in graph.graph.nodes
        if node.target is torch.ops.aten.as_strided.default
    }
    assert shared == {torch.ops.aten.rsqrt.default, torch.ops.aten.mul.Tensor}


def test_what_is_not_enabled_is_not_compiled():
    assert compiled(len, list, enabled=False) is len


@needs_compiler
def test_a_resumed_compiled_run_is_the_uninterrupted_one(tmp_path: Path, demos: Path):
    # Sums are split among the threads, so that their number is part of what a compiled run is: a
    # resumed run finds it in its directory, and these must not each measure it for themselves.
    options = ("compile_updates=true", "torch_threads=2")
    whole, halved = whole_and_halved(tmp_path, demos, *options)
    assert differences(everything(halved), everything(whole)) == []


@needs_compiler
def test_a_step_of_no_size_moves_nothing():
    """At the end of an annealing, with weights that never had a gradient: 0/0 if divided by it."""
    start = torch.tensor([0.5, -2.0, 0.0, 1e-3])
    weights = nn.Parameter(start.clone())
    optimizer = make_adam([([weights], 1e-2)])
    step = AdamStep(optimizer)
    set_recordable(optimizer, recorded=False, compiled=True)

    def update(batch: TensorDictBase) -> dict[str, Tensor]:
        weights.grad = batch["gradient"]
        step()
        return {}

    learn = Compiled(update, step.state)
    gradient = TensorDict({"gradient": torch.tensor([1.0, -1e-20, 0.0, 0.0])})
    learn(gradient)
    # Adam's first step is as long as the rate, against the gradient's sign; 1e-20 is small beside
    # its eps of 1e-8.
    torch.testing.assert_close(weights.detach(), start - torch.tensor([1e-2, 0.0, 0.0, 0.0]))
    moved = weights.detach().clone()
    optimizer.param_groups[0]["lr"].fill_(0.0)
    for _ in range(3):
        learn(gradient)
    assert torch.equal(weights, moved)
