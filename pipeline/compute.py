"""How a run uses the machine: threads, precision and compilation, decided where they are open."""

from __future__ import annotations

import os
import statistics
import time
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial

import psutil
import torch

from pipeline.machine.compilation import why_not_compiled
from pipeline.machine.products import onednn_products, onednn_wins
from pipeline.recipe import Recipe
from pipeline.updates import critic_updates

PRECISIONS = {"fp32": None, "bf16": torch.bfloat16}
"""What the hidden layers compute in; ``None`` is the parameters' own float32."""
REPEATS = 7
LOOK_S = 0.5
"""Seconds over which other work is observed."""
WORTH_A_THREAD = 0.85
"""A further thread must take an update's products to this share of the time, or it stays free."""
WORTH_ROUNDING = 0.7
"""bfloat16 must take the products to this share of float32's time to be chosen."""

OPEN = {
    "torch_threads": None,
    "precision": "auto",
    "compile_updates": None,
    "onednn": None,
    "cuda_graphs": None,
}
"""The keys that are decided here, by the value that leaves them open."""

MANY_UPDATES = 5_000
"""From so many on, a run on a processor looks for what makes an update faster: compiling takes up
to 20 s and saves 2 ms an update or more."""

Clock = Callable[[int, torch.dtype], float]
"""Seconds that the products of an update take with so many threads in this precision."""


def resolve_compute(recipe: Recipe, clock: Clock | None = None) -> Recipe:
    """A copy of ``recipe`` in which threads and precision are decided.

    ``torch_threads: null`` becomes the smallest count that is not clearly slower than a larger one,
    among the cores that other work leaves free; ``precision: auto`` becomes bf16 where the machine
    multiplies matrices of the run's size clearly faster in it, else fp32. For a run of many updates
    on a processor, ``compile_updates: null`` becomes true where there is a compiler, and ``onednn:
    null`` where oneDNN multiplies clearly faster and as exactly. The decision is saved with the
    run: a resumed run, and one that repeats it elsewhere, computes as it did.

    Args:
        recipe: A run's configuration.
        clock: Measures the machine; for tests.

    Raises:
        ValueError: If a value is not possible here, ``device`` if it is measured.
    """
    if clock is None:
        require_device(recipe.device)
        clock = _products(recipe)
    threads, precision = recipe.torch_threads, recipe.precision
    if threads is None:
        threads = _fastest_threads(clock) if recipe.device == "cpu" else _free_cores()
    many = recipe.device == "cpu" and critic_updates(recipe) >= MANY_UPDATES
    onednn = recipe.onednn
    if onednn is None:
        onednn = many and onednn_wins(partial(clock, threads, torch.float32))
    if precision == "auto":
        with onednn_products() if onednn else nullcontext():
            share = clock(threads, torch.bfloat16) / clock(threads, torch.float32)
        precision = "bf16" if share < WORTH_ROUNDING else "fp32"
    return recipe.changed(
        torch_threads=threads,
        precision=precision,
        onednn=onednn,
        compile_updates=_compiles_updates(recipe.compile_updates, many),
    )


def require_device(device: str) -> None:
    """Looks for ``device`` before minutes of work.

    Raises:
        ValueError: If it is unknown or not there.
    """
    try:
        torch.empty(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        why = str(error).strip().splitlines()[0]
        raise ValueError(
            f"device={device} cannot be used ({why}): set device=cpu, or one that torch finds here."
        ) from error


def hidden_dtype(recipe: Recipe) -> torch.dtype | None:
    """The precision of the hidden layers of a decided configuration."""
    return PRECISIONS[recipe.precision]


def replays_updates(recipe: Recipe) -> bool:
    """Whether the run's updates are CUDA graphs: on such a device, unless it is told not to.

    Raises:
        ValueError: If it is told to on another device.
    """
    on_cuda = torch.device(recipe.device).type == "cuda"
    if recipe.cuda_graphs and not on_cuda:
        raise ValueError(
            f"cuda_graphs=true needs a CUDA device, and device is {recipe.device}: "
            "set device=cuda, or leave cuda_graphs=null."
        )
    return on_cuda if recipe.cuda_graphs is None else recipe.cuda_graphs


def _compiles_updates(wanted: bool | None, many: bool) -> bool:
    if wanted is None and not many:
        return False
    problem = None if wanted is False else why_not_compiled()
    if problem is None:
        return wanted is not False
    if wanted:
        raise ValueError(
            f"compile_updates=true needs a C++ compiler and Python's headers ({problem}): install "
            "them (on Debian: g++ and python3-dev), or leave compile_updates=null."
        )
    warnings.warn(
        f"Updates are not compiled and take up to twice as long ({problem}). Install a C++ "
        "compiler and Python's headers (Debian: g++, python3-dev), or set compile_updates=false.",
        stacklevel=2,
    )
    return False


def _fastest_threads(clock: Clock) -> int:
    best, best_time = 1, clock(1, torch.float32)
    for threads in range(2, _free_cores() + 1):
        seconds = clock(threads, torch.float32)
        if seconds < WORTH_A_THREAD * best_time:
            best, best_time = threads, seconds
    return best


def _free_cores() -> int:
    """Cores of this process that other work leaves free at this moment.

    Observed, not the load average of the last minute: that still counts what has just ended, and
    the second of two runs in a row would get one thread. Threads that wait for a core hold up all
    others of their operation: two threads beside two busy processes on two cores were 15 times
    slower than one.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    busy = psutil.cpu_percent(interval=LOOK_S) / 100.0 * (psutil.cpu_count() or 1)
    free = round((cores or 1) - busy)
    allowed = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(free, int(allowed)) if allowed.isdigit() else free)


def _products(recipe: Recipe) -> Clock:
    """Times the matrix products of a critic's hidden layer at this run's sizes."""
    width = max(recipe.critic.hidden)
    rows = round(recipe.sampler.batch_size * (1 + recipe.sampler.demo_ratio))
    shape = (recipe.critic.num_critics, rows, width)

    def measure(threads: int, dtype: torch.dtype) -> float:
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            x = torch.ones(shape, dtype=dtype, device=recipe.device)
            weight = torch.ones(shape[0], width, width, dtype=dtype, device=recipe.device)
            times = []
            for _ in range(REPEATS):
                began = time.perf_counter()
                # The forward product, and the two of its backward pass.
                y = torch.bmm(x, weight)
                total = torch.bmm(y, weight.mT).sum() + torch.bmm(x.mT, y).sum()
                total.item()  # an accelerator has finished when its result is here
                times.append(time.perf_counter() - began)
        finally:
            torch.set_num_threads(before)
        return statistics.median(times)

    return measure
