"""``bcsac demos-check`` and ``bcsac record``: demonstrations that are there, or are made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from envs.registry import FORMS
from pipeline.cli.options import Overrides, TaskName, changes, named_first
from pipeline.files import again
from pipeline.literals import TASK_KEY


def demos_check(
    source: Annotated[str, typer.Argument(help="bundled | path | minari:ID")] = "",
    overrides: Overrides = None,
    task: Annotated[str | None, typer.Option(help=f"What they are of: {FORMS}.")] = None,
    resimulate: Annotated[bool | None, typer.Option(help="As demos.resimulate=.")] = None,
) -> None:
    """Validate a demonstration source: episodes, starts, findings. Fails where training would."""
    from pipeline.commands.demos_check import check_demonstrations
    from pipeline.overrides import recipe_of

    source, changed = named_first(source, overrides)
    recipe = recipe_of(changes(task, changed))
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
    run, changed = named_first(run, overrides)
    if bool(run) == (policy is not None):
        given = f"RUN={run} and POLICY={policy}" if run else "neither"
        raise ValueError(
            "make record takes RUN=dir (its policy acts) or POLICY=path.py:function with TASK=, "
            f"got {given}"
        )
    path = out if out is not None else str(Path(run) / "demonstrations.h5")
    if out is None and Path(path).exists():
        raise ValueError(f"{path} exists: say OUT={path} to replace it, or name another")
    from pipeline.commands.demonstrator import Demonstrator
    from pipeline.commands.record import record_demonstrations

    given_changes = changes(task, changed)
    demonstrator = (
        Demonstrator.of_run(Path(run), given_changes)
        if policy is None
        else Demonstrator.of_controller(policy, given_changes)
    )
    card = record_demonstrations(
        demonstrator, path, episodes=episodes, attempts=attempts, seed=seed
    )
    check = again.command(
        "demos-check", "", {}, [f"{TASK_KEY}={card['task']}", *changed], DEMOS=path
    )
    typer.echo(f"{_told(card)} are in {path}. Next: {check}")


def _told(card: Mapping[str, Any]) -> str:
    good, tried = card["admitted"], card["attempts"]
    passed = "succeeded" if card["admission"] == "success" else f"are good by {card['admission']}"
    return (
        f"{good} of {tried} episodes {passed} ({100 * good / tried:.0f} %); "
        f"the first {card['kept']}"
    )
