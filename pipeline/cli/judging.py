"""``bcsac eval`` and ``bcsac robust``: how good a run's policy is, and what breaks it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from tabulate import tabulate

from pipeline.cli.options import Overrides, RunDir, TaskName, changes
from pipeline.files.run_files import EVALUATION
from pipeline.machine.extras import require_extras
from pipeline.results.robustness import BAR, FIGURE, ROBUSTNESS
from pipeline.results.robustness import EPISODES as EPISODES_A_SETTING


def evaluate(
    run: RunDir,
    overrides: Overrides = None,
    task: TaskName = None,
    episodes: Annotated[int | None, typer.Option(help="Default: the run's own.")] = None,
    demos: Annotated[str | None, typer.Option(help="Also say how alike to these it moves.")] = None,
    strategies: Annotated[
        bool | None, typer.Option(help="How it goes about it; default: where the task can tell.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="JSON; default: RUN/evaluation.json")] = None,
) -> None:
    """Evaluate the newest checkpoint of RUN; episodes.csv beside it has a row per episode."""
    from pipeline.commands.evaluate_run import run_evaluation
    from pipeline.commands.extras import AskedFor
    from pipeline.commands.extras.likeness import LikenessTo
    from pipeline.commands.extras.strategies import StrategiesAsked

    extras: list[AskedFor] = [StrategiesAsked(strategies)]
    if demos is not None:
        extras.append(LikenessTo(demos))
    result = run_evaluation(run, changes(task, overrides), episodes, extras)
    path = out if out is not None else run / EVALUATION
    path.parent.mkdir(parents=True, exist_ok=True)
    result.write(path)
    typer.echo(tabulate(_scalars(result.metrics).items(), floatfmt=".4g"))
    typer.echo(f"written to {path}")


def robust(
    run: RunDir,
    overrides: Overrides = None,
    task: TaskName = None,
    episodes: Annotated[int, typer.Option(help="Of each setting.")] = EPISODES_A_SETTING,
    bar: Annotated[float, typer.Option(help="Success below which a setting breaks it.")] = BAR,
    only: Annotated[str, typer.Option(help="Kinds, comma-separated: delay,mass")] = "",
    out: Annotated[Path | None, typer.Option(help="Folder; default: RUN")] = None,
) -> None:
    """Play RUN's policy under noise, delays and other models, and say what breaks it first."""
    require_extras(["matplotlib"], "make robust")
    from pipeline.commands.robust import robustness
    from pipeline.results.robustness_figure import plot_robustness

    folder = run if out is None else out
    folder.mkdir(parents=True, exist_ok=True)
    found = robustness(
        run,
        changes(task, overrides),
        episodes=episodes,
        bar=bar,
        kinds=[kind for kind in only.split(",") if kind],
        report=typer.echo,
    )
    plot_robustness(found, folder / FIGURE)
    found.write(folder)
    typer.echo(found.markdown())
    typer.echo(f"written to {folder / ROBUSTNESS}")


def _scalars(result: Mapping[str, Any]) -> dict[str, Any]:
    flat = {**result} | {f"stage: {label}": share for label, share in result["stages"].items()}
    # None is what the task does not tell, progress for instance: the file has it.
    return {key: value for key, value in flat.items() if isinstance(value, (int, float, str))}
