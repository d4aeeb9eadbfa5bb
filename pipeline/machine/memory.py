"""Memory that runs out, told in one line."""

from __future__ import annotations

import torch


def told_memory(error: MemoryError | RuntimeError) -> str | None:
    """What there was no memory for and the remedy, in one line; None if ``error`` is another."""
    text = str(error) or type(error).__name__
    known = isinstance(error, MemoryError | torch.OutOfMemoryError)
    if not known and "allocate memory" not in text:  # torch has no class for it on a CPU
        return None
    what = " ".join(text.splitlines()[0].split())
    return (
        f"out of memory ({what}): lower what is large; sampler.capacity, growth.capacity, "
        "sampler.batch_size, actor.hidden, critic.hidden, env.num_envs and "
        "demos.multiply.target_episodes decide how much is needed"
    )
