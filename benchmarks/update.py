"""Milliseconds per update of ours and of other packages, and the share of the roofline reached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks import ours, roofline
from benchmarks.effort import Effort
from benchmarks.flops import update_flops
from benchmarks.statistics import rounded, spread
from benchmarks.worker import Entry, Timing, race

SIZES = {256: 256, 1024: 1024}
"""Width of the hidden layers and rows of a batch."""
VARIANTS = ("sac", "bc_sac", "bc_sac_single", "bc_sac_eager", "bc_sac_mixed", "da_sac")
TOGETHER = {256: 16, 1024: 4}
"""Updates that follow one another: ours draw their batches together, as a run does that collects
several frames at a time; sbx loops over them inside one compiled call."""


def our_overrides(name: str, width: int, batch: int) -> list[str]:
    """The configuration of one of our contestants.

    ``bc_sac`` is the paper's: ``batch`` replay rows and as many demonstrations for the imitation
    term; ``bc_sac_single`` draws each batch by itself, as the paper's preset does, which collects
    one frame at a time; ``bc_sac_eager`` is not compiled. ``bc_sac_mixed`` has the default
    preset's rows: ``batch`` in all, half of them demonstrations, all of them in the reinforcement
    terms.
    """
    particular = {
        "bc_sac_single": ["collector.frames_per_batch=1"],
        "bc_sac_eager": ["compile_updates=false"],
        "bc_sac_mixed": [f"sampler.batch_size={batch // 2}", "loss.rl_on_demos=true"],
    }
    return [
        *ours.paper_size("bc_sac" if name in particular else name, width, batch),
        f"collector.frames_per_batch={TOGETHER[width]}",
        *particular.get(name, []),
    ]


def flops(name: str, batch: int, width: int) -> int:
    """Operations of one update of a contestant."""
    own_rows = name.startswith("ours_bc_sac") and "mixed" not in name
    pure_imitation = batch if own_rows else 0
    return update_flops(width, batch, demo_rows=pure_imitation)


def entries(effort: Effort, width: int, batch: int) -> list[Entry]:
    """All contestants of a size: ours, the packages and the matrix products."""
    threads, rows = effort.threads, effort.replay_rows
    shared = {"width": width, "batch": batch, "replay_rows": rows}
    mine = [
        Entry(
            f"ours_{variant}_{precision}",
            "benchmarks.ours:make_updater",
            {
                "overrides": our_overrides(variant, width, batch),
                "precision": precision,
                "replay_rows": rows,
                "demo_rows": effort.demo_rows,
                "updates": TOGETHER[width],
            },
            threads,
        )
        for variant in VARIANTS
        for precision in ours.PRECISIONS
    ]
    packages = [
        Entry(
            name,
            "benchmarks.baselines:make_stable_baselines",
            {**shared, "package": package, "gradient_steps": steps},
            threads,
        )
        for name, package, steps in (
            ("sb3", "stable_baselines3", 1),
            ("sbx_single", "sbx", 1),
            ("sbx_looped", "sbx", TOGETHER[width]),
        )
    ]
    torchrl = Entry("torchrl", "benchmarks.baselines:make_torchrl_sac", shared, threads)
    return [*mine, *packages, torchrl, *roofline.entries(threads)]


def summarise(
    timings: Mapping[str, Timing], width: int, batch: int, threads: int
) -> dict[str, Any]:
    """The block of one size; plain numbers are medians in ms.

    Where a contestant ran in several ways, the plain number is its fastest: our precisions, and
    sbx with one gradient step per ``train`` (its default) or several in one compiled loop.
    """
    contestants = {n: t for n, t in timings.items() if not n.startswith("gemm_")}
    detail = {n: spread(t.seconds_per_unit, 1e3).as_json("ms") for n, t in contestants.items()}
    median = {n: float(values["median"]) for n, values in detail.items()}
    families = {
        **{f"ours_{v}": [f"ours_{v}_{p}" for p in ours.PRECISIONS] for v in VARIANTS},
        "sbx": ["sbx_single", "sbx_looped"],
        "sb3": ["sb3"],
        "torchrl": ["torchrl"],
    }
    fastest = {name: min(ways, key=median.__getitem__) for name, ways in families.items()}
    result: dict[str, Any] = {name: median[way] for name, way in fastest.items()}
    result["fastest"] = fastest
    others = ("sb3", "sbx", "torchrl")
    result["ratios"] = {
        f"{other}/{name}": rounded(result[other] / result[name], 3)
        for name in families
        if name.startswith("ours_")
        for other in others
    }
    ceilings = roofline.ceilings(timings, threads)
    result["ceilings_gflops"] = ceilings
    result["roofline"] = {
        name: _share(flops(name, batch, width), ms, name, ceilings) for name, ms in median.items()
    }
    return {**result, "width": width, "batch": batch, "detail": detail}


def _share(count: int, ms: float, name: str, ceilings: Mapping[str, float]) -> dict[str, Any]:
    """GFLOP of an update and the shares of the ceilings that it reaches."""
    precision = "bf16" if name.endswith("_bf16") else "fp32"
    rate = count / ms * 1e-6  # GFLOP/s
    return {
        "gflop": rounded(count * 1e-9),
        "gflops": rounded(rate),
        "precision": precision,
        "of_own_precision": rounded(rate / ceilings[precision], 3),
        "of_fastest": rounded(rate / max(ceilings.values()), 3),
    }


def run(effort: Effort) -> dict[str, Any]:
    """Key ``update``: a block for each size, with the ceilings measured in the same rounds."""
    result = effort.as_json(unit="ms per update", replay_rows=effort.replay_rows)
    for width, batch in SIZES.items():
        contestants = entries(effort, width, batch)
        timings = race(contestants, rounds=effort.rounds, block_s=effort.block_s)
        result[str(width)] = summarise(timings, width, batch, effort.threads)
    return {"update": result}
