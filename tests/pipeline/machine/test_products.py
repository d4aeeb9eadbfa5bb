"""Which library multiplies: switched for good or for a while, chosen if faster and as exact."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from pipeline.machine import products
from pipeline.machine.products import onednn_products, onednn_wins, use_onednn
from tests.pipeline.toys import built, tiny_config


def on() -> bool:
    return torch.backends.mkldnn.matmul.fp32_precision == "bf16"


def test_onednn_is_used_for_a_while():
    for before in (False, True):
        use_onednn(before)
        with onednn_products():
            assert on()
        assert on() is before


def machine(monkeypatch: pytest.MonkeyPatch, *, share: float, error: float) -> Callable[[], float]:
    """A clock on which oneDNN takes a ``share`` of the time, with ``error`` times the rounding."""
    monkeypatch.setattr(products, "_error", lambda: 1e-5 * (error if on() else 1.0))
    return lambda: 3.0 * (share if on() else 1.0)


@pytest.mark.parametrize(
    ("share", "error", "expected"),
    [
        (0.5, 1.0, True),
        (0.5, 3.0, True),
        (0.5, 4000.0, False),  # rounds the factors to bfloat16
        (0.84, 1.0, True),
        (0.86, 1.0, False),  # not worth a change
        (1.0, 1.0, False),  # another library is all there is
    ],
)
def test_onednn_is_chosen_if_clearly_faster_and_as_exact(
    share: float, error: float, expected: bool, monkeypatch: pytest.MonkeyPatch
):
    assert onednn_wins(machine(monkeypatch, share=share, error=error)) is expected
    assert not on()


def test_the_error_of_float32_is_known():
    """Sums of 256 products of numbers in (0, 1), at most 256: float32 has 24 bits, bfloat16 8."""
    exact = products._error()
    assert 1e-6 < exact < 256 * 256 * 2**-24
    left, right = torch.rand(2, 256, 256)
    rounded = (left.bfloat16() @ right.bfloat16()).double() - left.double() @ right.double()
    assert rounded.abs().max() > products.AS_EXACT * exact


@pytest.mark.parametrize("enabled", [True, False])
def test_a_run_multiplies_as_it_is_told(enabled: bool, tmp_path: Path, demos: Path):
    use_onednn(not enabled)
    run = built(tiny_config("sac", tmp_path, demos, f"onednn={str(enabled).lower()}"))
    assert on() is enabled
    run.train()
    assert all(parameter.isfinite().all() for parameter in run.actor.parameters())
