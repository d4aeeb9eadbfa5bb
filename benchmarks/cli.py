"""Command line: measures sections, merges them into the result file, renders the report."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks import (
    bars,
    environment,
    evaluation,
    loop,
    machine,
    memory,
    paper_preset,
    report,
    results,
    rlpd,
    roofline,
    scaling,
    update,
)
from benchmarks.effort import Effort
from benchmarks.worker import WorkerError, available_cores

SECTIONS: Mapping[str, Callable[[Effort], dict[str, Any]]] = {
    "roofline": roofline.run,
    "update": update.run,
    "rlpd": rlpd.run,
    "scaling": scaling.run,
    "environment": environment.run,
    "evaluation": evaluation.run,
    "memory": memory.run,
    "paper_preset": paper_preset.run,
    "loop": loop.run,
}
NEEDS_EXTRA = {"update": ("stable_baselines3", "sbx")}
DEFAULT_OUT = Path(__file__).parent / "results"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def missing_extra(sections: list[str]) -> list[str]:
    """Packages of the extra ``bench`` that these sections need and that are not installed."""
    needed = [package for section in sections for package in NEEDS_EXTRA.get(section, ())]
    return [package for package in needed if importlib.util.find_spec(package) is None]


@app.command()
def main(
    section: Annotated[
        list[str] | None, typer.Option(help=f"Of {', '.join(SECTIONS)}; default: all.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Minutes; not to be quoted.")] = False,
    out: Annotated[Path, typer.Option(help="Folder of latest.json and latest.md.")] = DEFAULT_OUT,
    threads: Annotated[int | None, typer.Option(help="Of each contestant; all cores.")] = None,
    train_frames: Annotated[int | None, typer.Option(help="Measured by `loop`.")] = None,
    paper_frames: Annotated[int | None, typer.Option(help="Measured by `paper_preset`.")] = None,
) -> None:
    """Measure; one section replaces its own part of an existing result file."""
    chosen = list(section or SECTIONS)
    unknown = [name for name in chosen if name not in SECTIONS]
    if unknown:
        _fail(f"unknown section {', '.join(unknown)}; known: {', '.join(SECTIONS)}")
    missing = missing_extra(chosen)
    if missing:
        _fail(
            f"{', '.join(missing)} not installed: run `make bench`, or "
            "`pip install -e .[bench]`; sections without them: "
            + ", ".join(name for name in SECTIONS if name not in NEEDS_EXTRA)
        )
    cores = available_cores()
    if threads is not None and not 1 <= threads <= cores:
        _fail(f"--threads must be 1 to {cores}, the cores this process may use; got {threads}")
    effort = Effort.make(quick=quick, threads=threads or cores)
    effort = dataclasses.replace(
        effort,
        train_frames=train_frames or effort.train_frames,
        paper_frames=paper_frames or effort.paper_frames,
    )
    try:
        _measure(chosen, effort, out)
    except (WorkerError, results.ResultsError, RuntimeError, ValueError) as error:
        _fail(str(error))


def _measure(chosen: list[str], effort: Effort, out: Path) -> None:
    here = machine.describe()
    path = out / results.JSON_NAME
    content = {} if len(chosen) == len(SECTIONS) else results.load(path)
    # Refused before measuring, not after it.
    content = results.merge(content, {}, here)
    for number, name in enumerate(chosen, start=1):
        began = time.perf_counter()
        print(f"[{number}/{len(chosen)}] {name} ...", end=" ", file=sys.stderr, flush=True)
        content = results.merge(content, SECTIONS[name](effort), here)
        content["bars"] = bars.evaluate(content)
        results.write(path, json.dumps(content, indent=2) + "\n")
        results.write(out / results.MARKDOWN_NAME, report.render(content))
        print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    print(f"written to {path} and {out / results.MARKDOWN_NAME}")


def _fail(message: str) -> None:
    print(f"error: {message}", file=sys.stderr)
    raise typer.Exit(2)
