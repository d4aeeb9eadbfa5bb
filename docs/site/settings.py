"""Reference of every setting of a recipe."""

from __future__ import annotations

from docs.site.tables import code, table
from pipeline.commands.settings import sections


def render() -> str:
    """The reference, a heading for each section."""
    parts = []
    for section in sections():
        rows = ((code(s.key), code(s.kind), code(s.default), s.meaning) for s in section.settings)
        title = f"`{section.name}`" if section.name else "Of the run itself"
        head = ("key", "type", "default", "meaning")
        parts.append(f"## {title}\n\n{section.says}\n\n{table(head, rows)}")
    return "\n\n".join(parts)
