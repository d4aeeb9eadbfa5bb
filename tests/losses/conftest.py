"""Every loss test is seeded and computes in float64.

In float64 a comparison of two ways to compute one number can be tight enough to leave no room for
a wrong formula.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture(autouse=True)
def float64_and_seed() -> Iterator[None]:
    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    torch.manual_seed(0)
    yield
    torch.set_default_dtype(default)
