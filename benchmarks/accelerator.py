"""Updates on a CUDA device: ours against other packages; ``python -m benchmarks.accelerator``.

Every contestant has its networks and its rows on the device, as far as it can (stable-baselines3
and sbx keep replay rows on the host), and does several gradient steps where one portion of frames
is followed by several: our preset draws their batches together, the others take
``gradient_steps``. The numbers stand in a file of their own: another machine made them than those
of ``latest.json``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from tabulate import tabulate

from benchmarks import machine, ours, results
from benchmarks.cli import DEFAULT_OUT
from benchmarks.statistics import spread
from benchmarks.update import SIZES
from benchmarks.worker import Entry, Timing, race

NAME = "accelerator"
STEPS = 16
"""Gradient steps that follow one portion of frames."""
THREADS = 8
"""Of the host."""
ROUNDS, BLOCK_S = 6, 0.4
OURS = {
    "ours_sac_fp32": ("sac", "fp32", True),
    "ours_bc_sac_fp32": ("bc_sac", "fp32", True),
    "ours_bc_sac_bf16": ("bc_sac", "bf16", True),
    "ours_bc_sac_fp32_eager": ("bc_sac", "fp32", False),
}
"""Variant, precision of the hidden layers, and whether updates are CUDA graphs."""
PACKAGES = {"sb3": "stable_baselines3", "sbx": "sbx"}


def entries(width: int, batch: int, device: str, rows: int) -> list[Entry]:
    """The contestants of a size."""
    mine = [
        Entry(
            name,
            "benchmarks.ours:make_updater",
            {
                "overrides": [
                    *ours.paper_size(variant, width, batch),
                    f"device={device}",
                    f"cuda_graphs={str(graphs).lower()}",
                    f"collector.frames_per_batch={STEPS}",
                ],
                "precision": precision,
                "replay_rows": rows,
                "demo_rows": 5_000,
                "updates": STEPS,
            },
            THREADS,
        )
        for name, (variant, precision, graphs) in OURS.items()
    ]
    shared = {"width": width, "batch": batch, "replay_rows": rows, "device": device}
    packages = [
        Entry(
            name,
            "benchmarks.baselines:make_stable_baselines",
            {**shared, "package": package, "gradient_steps": STEPS},
            THREADS,
        )
        for name, package in PACKAGES.items()
    ]
    torchrl = Entry("torchrl", "benchmarks.baselines:make_torchrl_sac", shared, THREADS)
    return [*mine, *packages, torchrl]


def summarise(timings: Mapping[str, Timing]) -> dict[str, Any]:
    """Milliseconds per update of each contestant."""
    return {name: spread(t.seconds_per_unit, 1e3).as_json("ms") for name, t in timings.items()}


def render(content: Mapping[str, Any]) -> str:
    """The table of a result."""
    made_on = content["machine"]
    sizes = [key for key in content if key.isdigit()]
    rows = [[name, *(_cell(content[size][name]) for size in sizes)] for name in content[sizes[0]]]
    table = tabulate(rows, ["ms per update", *(f"{s} x {s}" for s in sizes)], tablefmt="github")
    return (
        f"# Updates on {made_on['gpu']}\n\n{made_on['cpu']}, {made_on['cores']} cores, torch "
        f"{made_on['versions']['torch']}; `python -m benchmarks.accelerator`, median (quartiles) "
        f"of {content['rounds']} rounds, {STEPS} steps at a time, batch as large as the layers are "
        "wide.\nBC-SAC has as many demonstration rows again; the packages have no imitation term.\n"
        f"\n{table}\n"
    )


def _cell(ms: Mapping[str, Any]) -> str:
    return f"{ms['median']} ({ms['quartile_1']} - {ms['quartile_3']})"


def main(
    device: Annotated[str, typer.Option(help="As torch names it.")] = "cuda",
    out: Annotated[Path, typer.Option(help="Folder of the result files.")] = DEFAULT_OUT,
    rows: Annotated[int, typer.Option(help="In the replay buffers.")] = 100_000,
    width: Annotated[list[int] | None, typer.Option(help="Only layers this wide.")] = None,
) -> None:
    """Measure updates on a CUDA device."""
    if unknown := set(width or ()) - SIZES.keys():
        typer.echo(
            f"error: --width {min(unknown)}: there are {', '.join(map(str, SIZES))}.", err=True
        )
        raise typer.Exit(2)
    if not torch.cuda.is_available():
        typer.echo("error: no CUDA device; `make bench` measures the processor.", err=True)
        raise typer.Exit(2)
    # JAX takes three quarters of the device's memory otherwise, once for each process.
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    here = machine.describe() | {"gpu": torch.cuda.get_device_name(device)}
    content: dict[str, Any] = {"machine": here, "rounds": ROUNDS, "replay_rows": rows}
    for size in width or SIZES:
        contestants = entries(size, SIZES[size], device, rows)
        content[str(size)] = summarise(race(contestants, rounds=ROUNDS, block_s=BLOCK_S))
        results.write(out / f"{NAME}.json", json.dumps(content, indent=2) + "\n")
        results.write(out / f"{NAME}.md", render(content))
    typer.echo(render(content))


if __name__ == "__main__":
    typer.run(main)
