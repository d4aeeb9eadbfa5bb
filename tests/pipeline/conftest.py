"""Every pipeline test is seeded; a tiny demonstration file serves them all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from pipeline.machine.products import use_onednn
from tests.pipeline.toys import write_demos


@pytest.fixture(autouse=True)
def seed() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.manual_seed(0)
    yield
    torch.set_num_threads(threads)
    use_onednn(False)


@pytest.fixture
def float64() -> Iterator[None]:
    """Both sides of a comparison compute in float64, where rounding does not grow over updates."""
    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(default)


@pytest.fixture(scope="session")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_demos(tmp_path_factory.mktemp("demos") / "demos.h5")
