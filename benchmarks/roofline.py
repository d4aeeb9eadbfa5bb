"""The fastest matrix product of this machine: the ceiling of every update.

Square products through ``torch.mm`` into a given output, in the sizes of the paper's layers and
twice that, in float32 by the faster of the libraries that are as exact. The ceiling of a precision
is the fastest of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from benchmarks.effort import Effort
from benchmarks.statistics import rounded, spread
from benchmarks.worker import Entry, Timing, available_cores, race, timed_block
from pipeline.machine.products import onednn_wins, use_onednn

SIZES = (1024, 2048)
DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}
CHOICE_S = 0.2
"""Seconds of a look at each library."""


class MatrixProduct:
    """``C = A B`` of [n, n] matrices; a unit is one floating point operation."""

    def __init__(self, size: int, dtype: torch.dtype) -> None:
        generator = torch.Generator().manual_seed(0)
        left, right = (torch.randn(size, size, generator=generator).to(dtype) for _ in range(2))
        self.operands = left, right
        self.out = torch.empty(size, size, dtype=dtype)
        self.units = 2.0 * size**3

    def call(self) -> None:
        """One product."""
        torch.mm(*self.operands, out=self.out)


def make_matrix_product(size: int, precision: str) -> MatrixProduct:
    """A product in ``fp32`` or ``bf16``."""
    product = MatrixProduct(size, DTYPES[precision])
    if precision == "fp32":
        use_onednn(onednn_wins(lambda: timed_block(product, CHOICE_S)))
    return product


def entries(threads: int) -> list[Entry]:
    """All products on this many threads."""
    return [
        Entry(
            f"gemm_{precision}_{size}_{threads}",
            "benchmarks.roofline:make_matrix_product",
            {"size": size, "precision": precision},
            threads,
        )
        for precision in DTYPES
        for size in SIZES
    ]


def ceilings(timings: Mapping[str, Timing], threads: int) -> dict[str, float]:
    """GFLOP/s of the fastest product of each precision among those on this many threads."""
    return {
        precision: rounded(
            max(
                1e-9 / spread(timings[f"gemm_{precision}_{size}_{threads}"].seconds_per_unit).median
                for size in SIZES
            )
        )
        for precision in DTYPES
    }


def run(effort: Effort) -> dict[str, Any]:
    """Key ``roofline``: GFLOP/s by precision and threads."""
    counts = sorted({1, min(2, available_cores())})
    timings = race(
        [entry for count in counts for entry in entries(count)],
        rounds=effort.rounds,
        block_s=effort.block_s / 2,
    )
    result = effort.as_json(threads=counts, unit="GFLOP/s", sizes=list(SIZES))
    result["gflops"] = {str(count): ceilings(timings, count) for count in counts}
    result["detail"] = {
        name: {
            "median": rounded(1e-9 / spread(timing.seconds_per_unit).median),
            "quartile_1": rounded(1e-9 / spread(timing.seconds_per_unit).high),
            "quartile_3": rounded(1e-9 / spread(timing.seconds_per_unit).low),
        }
        for name, timing in timings.items()
    }
    return {"roofline": result}
