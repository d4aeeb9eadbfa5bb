"""``bcsac settings``: every key of a run."""

from __future__ import annotations

import textwrap
from typing import Annotated

import typer


def settings(
    words: Annotated[
        list[str] | None, typer.Argument(help="A section, a part of a key, a word of its meaning.")
    ] = None,
) -> None:
    """Settings of a run: key, values, default and what it means; all, or those about WORDS."""
    from pipeline.commands.settings import about

    for setting in about(words or []):
        typer.echo(f"{setting.key}: {setting.kind} = {setting.default}")
        if setting.meaning:
            typer.echo(textwrap.indent(textwrap.fill(setting.meaning, 92), "    "))
