"""Peak resident memory of a training process, in the default preset and at the paper's size."""

from __future__ import annotations

from typing import Any

from benchmarks.effort import Effort
from benchmarks.statistics import rounded
from benchmarks.worker import run_once
from configs import compose

PRESETS = ("default", "paper")


def run(effort: Effort) -> dict[str, Any]:
    """Keys ``memory_mib`` (whole-run peak of each preset) and ``memory_detail``.

    A short run of the real trainer is weighed, with an evaluation and a checkpoint. What the rest
    of its replay buffer will take is added by arithmetic. Pretraining and demonstration
    multiplication are left out: they run before the buffers are there and need less.
    """
    totals: dict[str, float] = {}
    detail = effort.as_json(unit="MiB", precision="auto")
    for preset in PRESETS:
        chosen = ["variant=dbc_sac", f"preset={preset}"]
        whole = compose(*chosen)
        batch = whole.collector.frames_per_batch
        frames = max(batch, effort.memory_frames // batch * batch)
        short = [
            *chosen,
            "precision=auto",
            "compile_updates=true",  # as in the whole run, which has updates enough
            "pretrain=false",
            "demos.multiply.enabled=false",
            f"collector.total_frames={frames}",
            f"collector.random_frames={min(whole.collector.random_frames, frames // 2)}",
            "optim.actor_delay=0",
            f"evaluation.interval={frames}",
        ]
        weighed = run_once(
            "benchmarks.training:train_and_weigh",
            threads=effort.threads,
            overrides=short,
            buffer_frames=whole.collector.total_frames,
        )
        totals[preset] = rounded(weighed["peak_mib"] + weighed["rest_of_buffer_mib"])
        detail[preset] = {name: rounded(value) for name, value in weighed.items()}
    return {"memory_mib": totals, "memory_detail": detail}
