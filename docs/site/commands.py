"""Reference of the command line: the Makefile's targets, and what they call."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from docs.site.places import ROOT
from docs.site.tables import code, table
from pipeline.cli import app

HEADING = re.compile(r"^##@ (.+)$")
TARGET = re.compile(r"^([a-z][a-z-]*):[^#]*## (.*)$")


def targets() -> dict[str, dict[str, str]]:
    """What the Makefile says of each of its targets, by its headings."""
    found: dict[str, dict[str, str]] = {}
    heading = ""
    for line in (ROOT / "Makefile").read_text().splitlines():
        if title := HEADING.match(line):
            heading = title[1]
        elif target := TARGET.match(line):
            found.setdefault(heading, {})[target[1]] = target[2]
    return found


def render_targets() -> str:
    """A table for each heading of the Makefile."""
    parts = []
    for heading, described in targets().items():
        rows = ((code(f"make {name}"), *_says(text)) for name, text in described.items())
        head = ("command", "what it does", "with")
        parts.append(f"### {heading}\n\n{table(head, rows)}")
    return "\n\n".join(parts)


def _says(text: str) -> tuple[str, str]:
    """A target's description, and from the first bracket on what it may be given."""
    says, bracket, given = text.partition(" [")
    return says, code(f"{bracket}{given}".strip())


def render_cli() -> str:
    """Every command of ``bcsac`` but ``train`` with its arguments and options."""
    parts = []
    for command in app.registered_commands:
        if command.callback is None:
            continue
        says = (inspect.getdoc(command.callback) or "").split("\n\n")[0]
        rows = list(_parameters(command.callback))
        head = ("argument", "type", "default", "meaning")
        parts.append(f"### `bcsac {command.name}`\n\n{says}\n\n{table(head, rows)}")
    return "\n\n".join(parts)


def _parameters(function: Callable[..., Any]) -> Iterator[tuple[str, str, str, str]]:
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kind, *told = (
            get_args(hints[name]) if get_origin(hints[name]) is Annotated else (hints[name],)
        )
        info = next((t for t in told if isinstance(t, ArgumentInfo | OptionInfo)), None)
        shown = name.upper() if isinstance(info, ArgumentInfo) else f"--{name.replace('_', '-')}"
        default = "" if parameter.default in (inspect.Parameter.empty, None) else parameter.default
        meaning = (info.help if info else "") or ""
        yield code(shown), code(inspect.formatannotation(kind)), code(default), meaning
