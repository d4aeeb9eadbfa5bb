"""Which library multiplies float32 matrices on a processor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

WORTH_SWITCHING = 0.85
"""oneDNN must take the products to this share of the other library's time to be chosen."""
AS_EXACT = 4.0
"""The error it may have in the other library's. Rounding to bfloat16 makes thousands."""

_SWITCH = torch.backends.mkldnn.matmul  # type: ignore[attr-defined]  # made at import


def use_onednn(enabled: bool) -> None:
    """Let oneDNN multiply float32 matrices, or the library that torch was built with, mostly MKL.

    Torch hands a float32 product to oneDNN only with the permission to round its factors to
    bfloat16. oneDNN makes use of it where that is faster, on processors with matrix units; on
    others it computes as exactly as MKL, and on AMD's twice as fast, where MKL keeps to the
    narrower vectors. :func:`onednn_wins` tells the two kinds apart.
    """
    _SWITCH.fp32_precision = "bf16" if enabled else "none"


@contextmanager
def onednn_products() -> Iterator[None]:
    """OneDNN within, and whatever it was afterwards."""
    before = _SWITCH.fp32_precision
    use_onednn(True)
    try:
        yield
    finally:
        _SWITCH.fp32_precision = before


def onednn_wins(seconds: Callable[[], float]) -> bool:
    """Whether oneDNN is clearly faster here and as exact.

    Args:
        seconds: Times a run's float32 products.
    """
    ordinary, error = seconds(), _error()
    with onednn_products():
        return _error() < AS_EXACT * error and seconds() < WORTH_SWITCHING * ordinary


def _error() -> float:
    """Largest error of a float32 product of numbers in (0, 1)."""
    generator = torch.Generator().manual_seed(0)
    left, right = torch.rand(2, 256, 256, generator=generator)
    return float((left @ right - (left.double() @ right.double())).abs().max())
