"""Command line of everything but training: evaluations, results, demonstrations, films."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from tabulate import tabulate

from envs.demonstrations import DemonstrationError
from envs.pictures import Picture, RenderingUnavailableError
from envs.registry import FORMS
from envs.task import TaskFailedError
from pipeline.commands.acting import Acting, task_override
from pipeline.commands.demos_check import check_demonstrations
from pipeline.commands.evaluate_run import run_evaluation
from pipeline.commands.extras import AskedFor
from pipeline.commands.extras.likeness import LikenessTo
from pipeline.commands.extras.strategies import StrategiesAsked
from pipeline.commands.play import play as play_episodes
from pipeline.commands.record import record_demonstrations
from pipeline.commands.robust import BAR, robustness
from pipeline.commands.robust import EPISODES as EPISODES_A_SETTING
from pipeline.commands.settings import about
from pipeline.files.full_disk import told
from pipeline.files.run_files import EVALUATION, as_json, write_atomically
from pipeline.film.choice import Choice
from pipeline.machine.extras import require_extras
from pipeline.non_finite import EXIT_CODE, NonFiniteError
from pipeline.results.evaluation_files import load_evaluation
from pipeline.results.reading import read_runs
from pipeline.results.robustness import FIGURE, ROBUSTNESS
from pipeline.results.run_tables import reference_of, render
from pipeline.run_dir import recipe_of

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
USER_ERRORS = (
    DemonstrationError,
    ImportError,
    RenderingUnavailableError,
    TaskFailedError,
    ValueError,
)
VIDEO_MODULES = ("imageio", "imageio_ffmpeg", "PIL")
RESULTS_MODULES = ("matplotlib", "pandas", "pyarrow", "rliable")
OVERRIDE = re.compile(r"\+{0,2}[a-z_]+(\.\w+)*=")
CELLS = Path("tasks/cells.parquet")
RunDir = Annotated[Path, typer.Argument(help="A run directory.")]
Overrides = Annotated[list[str] | None, typer.Argument(help="key=value on top of its config.")]
TaskName = Annotated[str | None, typer.Option("--task", help=f"Instead of RUN's: {FORMS}.")]
Episodes = Annotated[int | None, typer.Option(help="The first so many of the list.")]
Starts = Annotated[str | None, typer.Option(help="Episodes of the list by number: 3,17.")]
Worst = Annotated[int | None, typer.Option(help="So many that went worst in make eval.")]
Camera = Annotated[str | None, typer.Option(help="Its name; default: the task's own view.")]


@app.command("eval")
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
    changes = [*task_override(task), *(overrides or [])]
    extras: list[AskedFor] = [StrategiesAsked(strategies)]
    if demos is not None:
        extras.append(LikenessTo(demos))
    result = run_evaluation(run, changes, episodes, extras)
    path = out if out is not None else run / EVALUATION
    path.parent.mkdir(parents=True, exist_ok=True)
    result.write(path)
    typer.echo(tabulate(_scalars(result.metrics).items(), floatfmt=".4g"))
    typer.echo(f"written to {path}")


@app.command("robust")
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
    from pipeline.results.robustness_figure import plot_robustness  # noqa: PLC0415 - as below

    folder = run if out is None else out
    folder.mkdir(parents=True, exist_ok=True)
    found = robustness(
        run,
        [*task_override(task), *(overrides or [])],
        episodes=episodes,
        bar=bar,
        kinds=[kind for kind in only.split(",") if kind],
        told=typer.echo,
    )
    plot_robustness(found, folder / FIGURE)
    found.write(folder)
    typer.echo(found.markdown())
    typer.echo(f"written to {folder / ROBUSTNESS}")


@app.command("settings")
def settings(
    words: Annotated[
        list[str] | None, typer.Argument(help="A section, a part of a key, a word of its meaning.")
    ] = None,
) -> None:
    """Settings of a run: key, values, default and what it means; all, or those about WORDS."""
    for setting in about(words or []):
        typer.echo(f"{setting.key}: {setting.kind} = {setting.default}")
        if setting.meaning:
            typer.echo(textwrap.indent(textwrap.fill(setting.meaning, 92), "    "))


@app.command("table")
def table(
    runs: Annotated[list[Path], typer.Argument(help="Evaluated runs or evaluation JSON files.")],
    out: Annotated[Path | None, typer.Option(help="Also write the Markdown here.")] = None,
) -> None:
    """Several evaluated runs of one task beside its published rows (the door: Tables I and II)."""
    evaluations = [load_evaluation(run) for run in runs]
    text = render(evaluations, reference_of(evaluations))
    if out is not None:
        write_atomically(out, text + "\n")
    typer.echo(text)


@app.command("results")
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
    from pipeline.results.publish import has_tables, publish  # noqa: PLC0415 - needs extra `results`
    from pipeline.results.publish_cells import publish_cells, read_cells  # noqa: PLC0415 - as above

    if len(runs) == 1 and has_tables(runs[0]):
        out.mkdir(parents=True, exist_ok=True)
        for row in publish(runs[0], out, policies=policies, unclean=unclean):
            typer.echo(f"{row.name}: {len(row.runs)} seeds")
        typer.echo(f"written to {out}")
        return
    cells = read_cells(runs, out, unclean=unclean)
    total = len(publish_cells(cells, out))
    for cell in cells:
        typer.echo(", ".join(map(str, cell.keys)))
    typer.echo(f"{len(cells)} of {total} cells written to {out / CELLS}")


@app.command("plot")
def plot(
    run: Annotated[Path, typer.Argument(help="A run, a published seedN.json, or a row of them.")],
    out: Annotated[Path | None, typer.Option(help="PNG; default: diagnostics.png there")] = None,
) -> None:
    """Plot what learning curves hold: stages, gradients, values, entropy, imitation error."""
    require_extras(RESULTS_MODULES, "make plot")
    from pipeline.results.plots import plot_diagnostics  # noqa: PLC0415 - as above

    beside = run if run.is_dir() else run.parent
    path = out if out is not None else beside / "diagnostics.png"
    plot_diagnostics(run.name, read_runs([run]), path)
    typer.echo(f"written to {path}")


@app.command("report")
def report(
    runs: Annotated[list[Path], typer.Argument(help="Runs, evaluations, or folders of them.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/report"),
    only: Annotated[str, typer.Option(help="Sections, comma-separated: strategies")] = "",
) -> None:
    """Write one page (and Markdown) about runs: results, curves, maps, failures, provenance."""
    require_extras(("plotly", "jinja2"), "make report")
    from pipeline.report.build import MARKDOWN, PAGE, write_report  # noqa: PLC0415 - as above

    written = write_report(runs, out, [key for key in only.split(",") if key])
    typer.echo(written.summary)
    typer.echo(f"written to {out / PAGE} and {out / MARKDOWN}")


@app.command("demos-check")
def demos_check(
    source: Annotated[str, typer.Argument(help="bundled | path | minari:ID")] = "",
    overrides: Overrides = None,
    task: Annotated[str | None, typer.Option(help=f"What they are of: {FORMS}.")] = None,
    resimulate: Annotated[bool | None, typer.Option(help="As demos.resimulate=.")] = None,
) -> None:
    """Validate a demonstration source: episodes, starts, findings. Fails where training would."""
    source, changes = _named_first(source, overrides)
    recipe = recipe_of([*task_override(task), *changes])
    demos = recipe.demos
    check = check_demonstrations(
        source or demos.source,
        recipe.find_task(),
        resimulate=demos.resimulate if resimulate is None else resimulate,
        skip_refused=demos.skip_refused,
        env_options=recipe.env_options(),
    )
    typer.echo(check.text)
    if check.refusal is not None:
        raise typer.Exit(1)


@app.command("record")
def record(
    run: Annotated[str, typer.Argument(help="A run directory; '' with --policy.")] = "",
    overrides: Overrides = None,
    task: TaskName = None,
    policy: Annotated[
        str | None, typer.Option(help="path.py:function(observation [N, O]) -> action [N, A].")
    ] = None,
    out: Annotated[
        str | None, typer.Option(help="FILE.h5 (a recording), FILE.hdf5 (D4RL) or minari:ID")
    ] = None,
    episodes: Annotated[int, typer.Option(help="Successful episodes to keep.", min=1)] = 25,
    attempts: Annotated[int, typer.Option(help="Episodes to try at most.", min=1)] = 1000,
    seed: Annotated[int, typer.Option(help="Of the list of episodes.", min=0, max=2**32 - 1)] = 0,
) -> None:
    """Record a demonstration set, filtered by success, from RUN's policy or a controller."""
    run, changed = _named_first(run, overrides)
    if bool(run) == (policy is not None):
        given = f"RUN={run} and POLICY={policy}" if run else "neither"
        raise ValueError(
            "make record takes RUN=dir (its policy acts) or POLICY=path.py:function with TASK=, "
            f"got {given}"
        )
    path = out if out is not None else str(Path(run) / "demonstrations.h5")
    if out is None and Path(path).exists():
        raise ValueError(f"{path} exists: say OUT={path} to replace it, or name another")
    changes = [*task_override(task), *changed]
    acting = (
        Acting.of_run(Path(run), changes)
        if policy is None
        else Acting.of_controller(policy, changes)
    )
    card = record_demonstrations(acting, path, episodes=episodes, attempts=attempts, seed=seed)
    typer.echo(as_json(card, indent=2))
    typer.echo(f"written to {path}")


@app.command("video")
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
    from pipeline.commands.film import film  # noqa: PLC0415 - needs the extra `video`

    path = out if out is not None else run / "video.mp4"
    changes = [*task_override(task), *(overrides or [])]
    choice = Choice.parse(episodes, starts, worst)
    picture = Picture(size, size, camera)
    filmed = film(run, path, choice, changes, with_=with_, picture=picture)
    typer.echo(f"episodes {', '.join(map(str, filmed.numbers))}; written to {path}")


@app.command("strip")
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
    from pipeline.commands.strip import Layout  # noqa: PLC0415 - as above
    from pipeline.commands.strip import strip as make_strip  # noqa: PLC0415

    layout = Layout(episode, columns, until, size, camera)
    written = make_strip(runs, out, layout, task_override(task), with_=with_)
    typer.echo(f"written to {out} ({written / 1000:.0f} kB)")


@app.command("play")
def play(
    run: RunDir,
    overrides: Overrides = None,
    task: TaskName = None,
    episodes: Episodes = None,
    starts: Starts = None,
    worst: Worst = None,
) -> None:
    """Watch RUN's policy in a window, until it is closed."""
    given = any(value is not None for value in (episodes, starts, worst))
    choice = Choice.parse(episodes, starts, worst) if given else None
    shown = play_episodes(run, choice, [*task_override(task), *(overrides or [])])
    typer.echo(f"{shown} episodes")


def _named_first(first: str, overrides: list[str] | None) -> tuple[str, list[str]]:
    """What the first argument names, which may be left out, and the overrides."""
    if OVERRIDE.match(first) and not Path(first).exists():
        return "", [first, *(overrides or [])]
    return first, overrides or []


def _scalars(result: Mapping[str, Any]) -> dict[str, Any]:
    flat = {**result} | {f"stage: {label}": share for label, share in result["stages"].items()}
    # None is what the task does not tell, progress for instance: the file has it.
    return {key: value for key, value in flat.items() if isinstance(value, (int, float, str))}


def main() -> None:
    """Runs the command line; user errors become one line and exit code 1 (3: not finite)."""
    try:
        app()
    except NonFiniteError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(EXIT_CODE)
    except OSError as error:
        sys.exit(f"error: {told(error)}")
    except USER_ERRORS as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
