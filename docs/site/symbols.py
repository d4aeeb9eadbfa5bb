"""At which line of a Python file a name is defined."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def lines(path: Path) -> dict[str, int]:
    """First line of every class, function, method (``Class.method``) and constant of a file."""
    return _of(ast.parse(path.read_text()).body)


def _of(body: list[ast.stmt], within: str = "") -> dict[str, int]:
    found: dict[str, int] = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            found |= {within + node.name: node.lineno} | _of(node.body, f"{within}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            found[within + node.name] = node.lineno
        elif isinstance(node, ast.Assign):
            names = (target.id for target in node.targets if isinstance(target, ast.Name))
            found |= {within + name: node.lineno for name in names}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[within + node.target.id] = node.lineno
    return found
