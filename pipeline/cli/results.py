"""``bcsac table``, ``results``, ``plot`` and ``report``: pages and tables from finished runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.options import RESULTS_MODULES
from pipeline.machine.extras import require_extras

CELLS = Path("tasks/cells.parquet")


def table(
    runs: Annotated[list[Path], typer.Argument(help="Evaluated runs or evaluation JSON files.")],
    out: Annotated[Path | None, typer.Option(help="Also write the Markdown here.")] = None,
) -> None:
    """Several evaluated runs of one task beside its published rows (the door: Tables I and II)."""
    from pipeline.files.run_files import write_atomically
    from pipeline.results.evaluation_files import load_evaluation
    from pipeline.results.run_tables import reference_of, render

    evaluations = [load_evaluation(run) for run in runs]
    text = render(evaluations, reference_of(evaluations))
    if out is not None:
        write_atomically(out, text + "\n")
    typer.echo(text)


def results(
    runs: Annotated[
        list[Path], typer.Argument(help="Folder of runs, ROW/seedN below it; or several folders.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("docs/results"),
    policies: Annotated[bool, typer.Option(help="Export a policy per row.")] = True,
    unclean: Annotated[
        bool, typer.Option("--unclean", help="Also runs of a working tree with changes.")
    ] = False,
) -> None:
    """Publish evaluated runs: a task's published tables, or else cells of the table over tasks."""
    require_extras(RESULTS_MODULES, "make results")
    from pipeline.results.publish import has_tables, publish
    from pipeline.results.publish_cells import publish_cells, read_cells

    if len(runs) == 1 and has_tables(runs[0]):
        out.mkdir(parents=True, exist_ok=True)
        for row in publish(runs[0], out, policies=policies, unclean=unclean):
            typer.echo(f"{row.name}: {len(row.runs)} seeds")
        typer.echo(f"written to {out}")
        return
    cells = read_cells(runs, out, unclean=unclean)
    published = publish_cells(cells, out, policies=policies)
    for cell in cells:
        typer.echo(", ".join(map(str, cell.keys)))
    typer.echo(f"{len(cells)} of {len(published)} cells written to {out / CELLS}")


def plot(
    run: Annotated[Path, typer.Argument(help="A run, a published seedN.json, or a row of them.")],
    out: Annotated[Path | None, typer.Option(help="PNG; default: diagnostics.png there")] = None,
) -> None:
    """Plot what learning curves hold: stages, gradients, values, entropy, imitation error."""
    require_extras(RESULTS_MODULES, "make plot")
    from pipeline.results.reading import read_runs

    found = read_runs([run])  # before the plots' libraries, which take a second to import
    from pipeline.results.plots import plot_diagnostics

    beside = run if run.is_dir() else run.parent
    path = out if out is not None else beside / "diagnostics.png"
    plot_diagnostics(run.name, found, path)
    typer.echo(f"written to {path}")


def report(
    runs: Annotated[list[Path], typer.Argument(help="Runs, evaluations, or folders of them.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/report"),
    only: Annotated[str, typer.Option(help="Sections, comma-separated: strategies")] = "",
) -> None:
    """Write one page (and Markdown) about runs: results, curves, maps, failures, provenance."""
    require_extras(("plotly", "jinja2", "rliable"), "make report")
    from pipeline.report.build import MARKDOWN, PAGE, write_report

    written = write_report(runs, out, [key for key in only.split(",") if key])
    typer.echo(written.summary)
    typer.echo(f"written to {out / PAGE} and {out / MARKDOWN}")
