"""The figures of an evaluation, from the dataclasses that hold them."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from typing import Any

from docs.site.tables import code, table
from envs.door.metrics import DoorMetrics
from pipeline.act.metrics import EpisodeMetrics

KINDS = {"Of every task": EpisodeMetrics, "Of the door besides": DoorMetrics}


def render() -> str:
    """A table for each class: name, type and what its docstring says."""
    head = ("figure", "type", "meaning")
    return "\n\n".join(
        f"## {title}\n\n{table(head, ((code(n), code(k), says) for n, k, says in fields(kind)))}"
        for title, kind in KINDS.items()
    )


def fields(kind: type[Any]) -> Iterator[tuple[str, str, str]]:
    """Name, annotation and documentation of every field of a dataclass.

    A field is documented by the string below it, or under ``Attributes:`` of the class.
    """
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(node, ast.ClassDef)
    of_class = _attributes(inspect.getdoc(kind) or "")
    for field, then in zip(node.body, [*node.body[1:], None], strict=True):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            name = field.target.id
            says = _string(then) or of_class.get(name, "")
            yield name, ast.unparse(field.annotation), says


def _string(node: ast.stmt | None) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""


def _attributes(documentation: str) -> dict[str, str]:
    """What Google's style says below ``Attributes:``, by name."""
    _, _, part = documentation.partition("Attributes:\n")
    found: dict[str, str] = {}
    name = ""
    for line in part.split("\n\n")[0].splitlines():
        indented = line.startswith(" " * 8)
        if not indented and ":" in line:
            name, _, says = line.strip().partition(":")
            found[name] = says.strip()
        elif name:
            found[name] += f" {line.strip()}"
    return found
