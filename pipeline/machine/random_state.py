"""The random numbers of a run, untouched by what only looks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def kept_random_state(device: torch.device | str) -> Iterator[None]:
    """Leaves torch's random state as it was, that of ``device`` included."""
    on_cuda = torch.device(device).type == "cuda"
    with torch.random.fork_rng(devices=[device] if on_cuda else []):
        yield
