"""Command line of everything but training: evaluations, results, demonstrations, films."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from tabulate import tabulate

from envs.demonstrations import DemonstrationError, format_reports, load_demonstrations
from pipeline.evaluate_run import evaluate_run, load_evaluation
from pipeline.film import film
from pipeline.record import record_demonstrations
from pipeline.run_dir import EVALUATION, LEARNING_CURVE, RunDirectoryError, write_atomically
from pipeline.tables import render

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
RunDir = Annotated[Path, typer.Argument(help="A run directory.")]
Overrides = Annotated[list[str] | None, typer.Argument(help="key=value on top of its config.")]


@app.command("eval")
def evaluate(
    run: RunDir,
    overrides: Overrides = None,
    episodes: Annotated[int | None, typer.Option(help="Doors; default: the run's own.")] = None,
    out: Annotated[Path | None, typer.Option(help="JSON; default: RUN/evaluation.json")] = None,
) -> None:
    """Evaluate the newest checkpoint of RUN: the columns of Tables I and II."""
    result = evaluate_run(run, overrides or [], episodes)
    path = out if out is not None else run / EVALUATION
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(result, indent=2) + "\n")
    typer.echo(tabulate(_scalars(result).items(), floatfmt=".4g"))
    typer.echo(f"written to {path}")


@app.command("table")
def table(
    runs: Annotated[list[Path], typer.Argument(help="Evaluated runs or evaluation JSON files.")],
    out: Annotated[Path | None, typer.Option(help="Also write the Markdown here.")] = None,
) -> None:
    """Tables I and II of several evaluated runs beside the paper's numbers."""
    text = render([load_evaluation(run) for run in runs])
    if out is not None:
        write_atomically(out, text + "\n")
    typer.echo(text)


@app.command("results")
def results(
    runs: Annotated[Path, typer.Argument(help="Folder of runs, ROW/seedN below it.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("docs/results"),
    policies: Annotated[bool, typer.Option(help="Export a policy per row.")] = True,
) -> None:
    """Publish evaluated runs: tables over seeds, curves, diagnostics and a policy per row."""
    from pipeline.results.publish import publish  # noqa: PLC0415 - needs the extra `results`

    out.mkdir(parents=True, exist_ok=True)
    for row in publish(runs, out, policies=policies):
        typer.echo(f"{row.name}: {len(row.seeds)} seeds")
    typer.echo(f"written to {out}")


@app.command("plot")
def plot(
    run: RunDir,
    out: Annotated[Path | None, typer.Option(help="PNG; default: RUN/diagnostics.png")] = None,
) -> None:
    """Plot what RUN's learning curve holds: stages, gradients, values, entropy, imitation error."""
    from pipeline.results.plots import plot_diagnostics  # noqa: PLC0415 - as above
    from pipeline.results.rows import read_lines  # noqa: PLC0415

    path = out if out is not None else run / "diagnostics.png"
    plot_diagnostics(run.name, [read_lines(run / LEARNING_CURVE)], path)
    typer.echo(f"written to {path}")


@app.command("demos-check")
def demos_check(
    source: Annotated[str, typer.Argument(help="bundled | path | minari:ID")] = "bundled",
    resimulate: Annotated[bool, typer.Option(help="Replay in our simulator.")] = True,
) -> None:
    """Validate a demonstration source and tabulate its episodes."""
    loaded = load_demonstrations(source, resimulate=resimulate)
    typer.echo(format_reports(loaded.reports))


@app.command("record")
def record(
    run: RunDir,
    out: Annotated[
        Path | None, typer.Option(help="HDF5 file; default: RUN/demonstrations.h5")
    ] = None,
    episodes: Annotated[int, typer.Option(help="Successful episodes to keep.")] = 25,
    attempts: Annotated[int, typer.Option(help="Doors to try at most.")] = 1000,
    seed: Annotated[int, typer.Option(help="Of the list of doors.")] = 0,
) -> None:
    """Record a demonstration set from RUN's policy, filtered by success (the paper's ILD)."""
    path = out if out is not None else run / "demonstrations.h5"
    card = record_demonstrations(run, path, episodes=episodes, attempts=attempts, seed=seed)
    typer.echo(json.dumps(card, indent=2))
    typer.echo(f"written to {path}")


@app.command("video")
def video(
    run: RunDir,
    out: Annotated[Path | None, typer.Option(help="MP4 file; default: RUN/video.mp4")] = None,
    episodes: Annotated[int, typer.Option(help="Doors to film, one after the other.")] = 3,
) -> None:
    """Film RUN's policy."""
    path = out if out is not None else run / "video.mp4"
    film(run, path, episodes)
    typer.echo(f"written to {path}")


def _scalars(result: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in result.items() if v is None or isinstance(v, (int, float, str))}


def main() -> None:
    """Runs the command line; user errors become one line and exit code 1."""
    try:
        app()
    except (DemonstrationError, RunDirectoryError, ValueError, OSError, ImportError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
