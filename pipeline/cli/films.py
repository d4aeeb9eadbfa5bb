"""``bcsac video``, ``strip`` and ``play``: what a run's policy looks like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from envs.pictures import Picture
from pipeline.cli.options import (
    VIDEO_MODULES,
    Camera,
    Episodes,
    Overrides,
    RunDir,
    Starts,
    TaskName,
    Worst,
    changes,
)
from pipeline.machine.extras import require_extras


def video(
    run: RunDir,
    overrides: Overrides = None,
    task: TaskName = None,
    out: Annotated[Path | None, typer.Option(help="MP4 or GIF; default: RUN/video.mp4")] = None,
    episodes: Episodes = None,
    starts: Starts = None,
    worst: Worst = None,
    with_: Annotated[
        str | None,
        typer.Option("--with", help="Beside it: another run, demos (the run's), or a source."),
    ] = None,
    camera: Camera = None,
    size: Annotated[int, typer.Option(help="Width and height of a picture, px.")] = 480,
) -> None:
    """Film RUN's policy in chosen episodes, alone or beside another or a demonstration."""
    require_extras(VIDEO_MODULES, "make video")
    from pipeline.film.choice import Choice

    choice = Choice.parse(episodes, starts, worst)
    from pipeline.commands.film import film

    path = out if out is not None else run / "video.mp4"
    picture = Picture(size, size, camera)
    filmed = film(run, path, choice, changes(task, overrides), with_=with_, picture=picture)
    typer.echo(f"episodes {', '.join(map(str, filmed.numbers))}; written to {path}")


def strip(
    runs: Annotated[list[Path], typer.Argument(help="Run directories of one task.")],
    task: TaskName = None,
    out: Annotated[Path, typer.Option(help="PNG file.")] = Path("runs/strip.png"),
    with_: Annotated[
        str | None, typer.Option("--with", help="First row: demos (the run's), or a source.")
    ] = None,
    episode: Annotated[int, typer.Option(help="Number in the task's list.")] = 0,
    columns: Annotated[int, typer.Option(help="Pictures in a row.")] = 6,
    until: Annotated[int | None, typer.Option(help="Control step of the last one.")] = None,
    camera: Camera = None,
    size: Annotated[int, typer.Option(help="Width and height of a picture, px.")] = 180,
) -> None:
    """Write one picture with a row of moments for each policy."""
    require_extras(VIDEO_MODULES, "make strip")
    from pipeline.commands.strip import Layout
    from pipeline.commands.strip import strip as make_strip

    layout = Layout(episode, columns, until, size, camera)
    written = make_strip(runs, out, layout, changes(task), with_=with_)
    typer.echo(f"written to {out} ({written / 1000:.0f} kB)")


def play(
    run: RunDir,
    overrides: Overrides = None,
    task: TaskName = None,
    episodes: Episodes = None,
    starts: Starts = None,
    worst: Worst = None,
) -> None:
    """Watch RUN's policy in a window, until it is closed."""
    from pipeline.film.choice import Choice

    given = any(value is not None for value in (episodes, starts, worst))
    choice = Choice.parse(episodes, starts, worst) if given else None
    from pipeline.commands.play import play as play_episodes

    shown = play_episodes(run, choice, changes(task, overrides))
    typer.echo(f"{shown} episodes")
