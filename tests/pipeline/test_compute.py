"""Threads, precision, compilation: what is open is decided once, what is given is kept."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import torch

from configs import compose
from pipeline import compute
from pipeline.compute import hidden_dtype, replays_updates, resolve_compute
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from tests.pipeline.toys import built, tiny_config

FP32, BF16 = torch.float32, torch.bfloat16


def open_config(*overrides: str) -> Recipe:
    return compose("variant=sac", "preset=smoke", "run_dir=nowhere", *overrides)


class FakeClock:
    """Seconds by number of threads, and bfloat16's share of them."""

    def __init__(self, *seconds: float, bf16_share: float = 1.0) -> None:
        self.seconds = seconds
        self.bf16_share = bf16_share
        self.asked: list[tuple[int, torch.dtype]] = []

    def __call__(self, threads: int, dtype: torch.dtype) -> float:
        self.asked.append((threads, dtype))
        return self.seconds[threads - 1] * (self.bf16_share if dtype == BF16 else 1.0)


def refused(*_arguments: object) -> float:
    raise AssertionError("measured, although nothing was left open")


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Sets the cores of this process, how many of them are busy and OMP_NUM_THREADS."""

    def is_like(cores: int, busy: float = 0.0, omp: str | None = None) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
        monkeypatch.setattr(psutil, "cpu_count", lambda: cores)
        monkeypatch.setattr(psutil, "cpu_percent", lambda interval: 100.0 * busy / cores)
        if omp is None:
            monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        else:
            monkeypatch.setenv("OMP_NUM_THREADS", omp)

    is_like(4)
    return is_like


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        ((1.0, 0.5, 0.4, 0.3), 4),
        ((1.0, 0.86, 0.86, 0.86), 1),  # a little faster is not worth a core
        ((1.0, 0.84, 0.80, 0.75), 2),  # 0.75 / 0.84 is 0.89
        ((1.0, 0.9, 0.6, 0.6), 3),  # two are not worth it, three are
        ((1.0, 15.0, 15.0, 15.0), 1),
        ((1.0, 0.5, 5.0, 0.45), 2),
    ],
)
def test_the_smallest_count_that_is_not_clearly_slower_is_chosen(
    seconds: tuple[float, ...], expected: int
):
    clock = FakeClock(*seconds)
    assert resolve_compute(open_config(), clock).torch_threads == expected
    assert clock.asked == [(threads, FP32) for threads in (1, 2, 3, 4)]


@pytest.mark.parametrize(
    ("cores", "busy", "omp", "most"),
    [
        (4, 0.0, None, 4),
        (4, 0.4, None, 4),
        (4, 1.6, None, 2),
        (4, 4.0, None, 1),
        (4, 0.0, "3", 3),
        (4, 0.0, "1", 1),
        (4, 0.0, "8", 4),  # a limit, not more cores
        (4, 0.0, "", 4),
        (4, 0.0, "2,1", 4),  # by nesting level: not a number of cores
        (4, 2.0, "3", 2),
        (16, 4.0, "4", 4),  # what is busy is the machine's: twelve cores are free, four allowed
        (1, 0.0, None, 1),
    ],
)
def test_no_more_threads_than_free_cores_are_tried(
    machine: Callable[..., None], cores: int, busy: float, omp: str | None, most: int
):
    machine(cores, busy, omp)
    clock = FakeClock(*(0.5**threads for threads in range(16)))
    assert resolve_compute(open_config(), clock).torch_threads == most
    assert max(threads for threads, _ in clock.asked) == most


def test_a_machine_that_does_not_tell_its_affinity_counts_all_cores(
    machine: Callable[..., None], monkeypatch: pytest.MonkeyPatch
):
    machine(4)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    clock = FakeClock(*(0.5**threads for threads in range(16)))
    assert resolve_compute(open_config(), clock).torch_threads == 3


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize(
    ("share", "expected"), [(0.5, "bf16"), (0.69, "bf16"), (0.71, "fp32"), (3.0, "fp32")]
)
def test_bf16_is_chosen_only_where_it_is_clearly_faster(share: float, expected: str):
    clock = FakeClock(1.0, 0.5, 0.5, 0.5, bf16_share=share)
    decided = resolve_compute(open_config("precision=auto"), clock)
    assert decided.precision == expected
    assert hidden_dtype(decided) is (BF16 if expected == "bf16" else None)
    assert (2, BF16) in clock.asked  # compared at the threads that the run will have
    assert {threads for threads, dtype in clock.asked if dtype == BF16} == {2}


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_given_values_are_kept_and_nothing_is_measured(precision: str):
    given = ["torch_threads=3", f"precision={precision}"]
    given += ["compile_updates=false", "onednn=true"]
    config = open_config(*given)
    assert resolve_compute(config, refused) == config


def test_a_decision_is_not_taken_again():
    decided = resolve_compute(open_config("precision=auto"), FakeClock(*[1.0] * 64))
    assert resolve_compute(decided, refused) == decided


@pytest.mark.usefixtures("machine")
def test_only_what_was_open_changes_and_only_in_the_copy():
    config = open_config("precision=auto", "seed=7")
    before = config.plain()
    decided = resolve_compute(config, FakeClock(1.0, 0.5, 0.5, 0.5, bf16_share=0.5))
    assert config.plain() == before
    assert before["torch_threads"] is None
    expected = before | {"torch_threads": 2, "precision": "bf16"}
    expected |= {"compile_updates": False, "onednn": False}
    assert decided.plain() == expected


@pytest.mark.parametrize(
    ("load", "omp", "expected"), [(1.0, None, 3), (40.0, None, 1), (9, "2", 1)]
)
def test_an_accelerator_s_host_gets_the_free_cores_unmeasured(
    machine: Callable[..., None], load: float, omp: str | None, expected: int
):
    machine(4, load, omp)
    decided = resolve_compute(open_config("device=cuda"), refused)
    assert decided.torch_threads == expected


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("precision=fp16", r"precision='fp16': .*'fp32', 'bf16' or 'auto'"),
        ("precision=''", r"precision='': .*'fp32', 'bf16' or 'auto'"),
        ("torch_threads=0", r"torch_threads=0: must be 1 or more"),
        ("torch_threads=-2", r"torch_threads=-2: must be 1 or more"),
    ],
)
def test_a_bad_value_is_named(override: str, message: str):
    with pytest.raises(ValueError, match=message):
        resolve_compute(open_config(override), refused)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_machine_is_measured_without_a_trace(threads: int):
    """The real clock: it takes time, with so many threads, and leaves their number as it was."""
    torch.set_num_threads(3)
    seen = []
    bmm = torch.bmm

    def watched(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        seen.append((torch.get_num_threads(), left.dtype, tuple(left.shape)))
        return bmm(left, right)

    config = open_config("critic.num_critics=3", "critic.hidden=[8,20]", "sampler.demo_ratio=0.5")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "bmm", watched)
        assert compute._products(config)(threads, BF16) > 0.0
    # 32 rows and half as many demonstrations, for each of three critics, 20 wide.
    assert set(seen) == {(threads, BF16, (3, 48, 20)), (threads, BF16, (3, 20, 48))}
    assert torch.get_num_threads() == 3


def test_the_thread_count_is_put_back_when_a_measurement_fails(monkeypatch: pytest.MonkeyPatch):
    torch.set_num_threads(3)
    monkeypatch.setattr(torch, "bmm", refused)
    with pytest.raises(AssertionError):
        compute._products(open_config())(1, FP32)
    assert torch.get_num_threads() == 3


# -------------------------------------------------------------------------------- in a whole run


@pytest.mark.usefixtures("machine")
def test_the_decision_is_saved_with_the_run_and_a_resumed_run_repeats_it(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    clock = FakeClock(1.0, 0.5, 0.5, 0.5, bf16_share=0.5)
    monkeypatch.setattr(compute, "_products", lambda _config: clock)
    run = built(tiny_config("sac", tmp_path, demos, "precision=auto"))
    assert torch.get_num_threads() == 2
    run.trainer.total_frames = 20
    run.train()
    saved = load_recipe(run.run_dir)
    assert (saved.torch_threads, saved.precision) == (2, "bf16")
    assert run.recipe == saved
    assert hidden_layers_of(run) == {BF16}

    monkeypatch.setattr(compute, "_products", lambda _config: refused)
    torch.set_num_threads(1)
    resumed = built(load_recipe(run.run_dir), resume=True)
    assert torch.get_num_threads() == 2
    assert hidden_layers_of(resumed) == {BF16}
    resumed.train()
    again = load_recipe(run.run_dir)
    assert (again.torch_threads, again.precision) == (2, "bf16")


def hidden_layers_of(run: object) -> set[torch.dtype | None]:
    loss = run.trainer.loss_module
    parts = [*loss.actor.modules(), *loss.critic.modules(), *loss.target_critic.modules()]
    return {part.dtype for part in parts if hasattr(part, "dtype") and hasattr(part, "layers")}


@pytest.mark.parametrize("variant", ["bc_sac", "bc"])
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_a_run_computes_in_the_precision_it_was_given(
    variant: str, precision: str, tmp_path: Path, demos: Path
):
    options = ["torch_threads=1", f"precision={precision}"]
    run = built(tiny_config(variant, tmp_path, demos, *options))
    run.train()
    expected = BF16 if precision == "bf16" else None
    actors = [part for part in run.actor.modules() if hasattr(part, "layers")]
    assert {part.dtype for part in actors} == {expected}
    if variant != "bc":  # whose critic is not trained
        assert hidden_layers_of(run) == {expected}
    assert all(parameter.isfinite().all() for parameter in run.actor.parameters())
    assert {parameter.dtype for parameter in run.actor.parameters()} == {FP32}


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ([], False),
        (["cuda_graphs=false"], False),
        (["device=cuda"], True),
        (["device='cuda:1'", "cuda_graphs=true"], True),
        (["device=cuda", "cuda_graphs=false"], False),
    ],
)
def test_updates_are_replayed_on_cuda_unless_told_otherwise(overrides: list[str], expected: bool):
    assert replays_updates(open_config(*overrides)) is expected


def test_no_other_device_replays_updates():
    with pytest.raises(ValueError, match=r"cuda_graphs=true needs .* device is cpu: set device"):
        replays_updates(open_config("cuda_graphs=true"))


LONG = ["torch_threads=1", "optim.updates_per_frame=0.5", "collector.total_frames=10000"]
SHORT = [*LONG[:2], "collector.total_frames=9900"]  # whole portions of 100


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (LONG, True),
        (SHORT, False),
        ([*LONG, "compile_updates=false"], False),
        ([*SHORT, "compile_updates=true"], True),
        ([*LONG, "device=cuda"], False),
        ([*SHORT, "offline=true", "bc.updates=5000"], True),
        ([*LONG, "offline=true", "bc.updates=4900"], False),
    ],
)
def test_updates_are_compiled_where_there_are_many(
    overrides: list[str], expected: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(compute, "why_not_compiled", lambda: None)
    monkeypatch.setattr(compute, "onednn_wins", lambda seconds: False)
    assert resolve_compute(open_config(*overrides), refused).compile_updates is expected


def test_a_machine_that_cannot_compile_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compute, "why_not_compiled", lambda: "no g++")
    monkeypatch.setattr(compute, "onednn_wins", lambda seconds: False)
    with pytest.warns(UserWarning, match=r"not compiled .*no g\+\+.* compile_updates=false"):
        decided = resolve_compute(open_config(*LONG), refused)
    assert decided.compile_updates is False
    with pytest.raises(ValueError, match=r"compile_updates=true needs .*no g\+\+"):
        resolve_compute(open_config(*SHORT, "compile_updates=true"), refused)
    assert resolve_compute(open_config(*SHORT), refused).compile_updates is False


@pytest.mark.parametrize(
    ("overrides", "wins", "expected"),
    [
        (LONG, True, True),
        (LONG, False, False),
        (SHORT, True, False),
        ([*LONG, "onednn=false"], True, False),
        ([*SHORT, "onednn=true"], False, True),
        ([*LONG, "device=cuda"], True, False),
    ],
)
def test_onednn_multiplies_where_it_wins(
    overrides: list[str], wins: bool, expected: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(compute, "onednn_wins", lambda seconds: wins)
    options = [*overrides, "compile_updates=false"]
    assert resolve_compute(open_config(*options), refused).onednn is expected


def test_bf16_is_compared_with_the_library_that_multiplies():
    def clock(threads: int, dtype: torch.dtype) -> float:
        if dtype == BF16:
            return 1.0
        onednn = torch.backends.mkldnn.matmul.fp32_precision == "bf16"
        return 1.2 if onednn else 2.0

    for onednn, expected in (("true", "fp32"), ("false", "bf16")):
        options = ["torch_threads=1", "precision=auto", f"onednn={onednn}"]
        assert resolve_compute(open_config(*options), clock).precision == expected
