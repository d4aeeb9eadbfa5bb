"""Values of a command line that are names and paths, and mean themselves whatever they hold.

Of other values a comma is a sweep to Hydra and an equals sign an error, and ``a: b`` is a mapping
to YAML; folders have such names.
"""

from __future__ import annotations

from typing import Any, Final

TASK_KEY: Final = "task.name"
LITERAL: Final = frozenset({"run_dir", "resume", TASK_KEY, "demos.source", "cache_dir"})
"""Keys of such values."""


def literal(value: str) -> str:
    """What a value of :data:`LITERAL` means: itself, or what stands between its quotes."""
    if len(value) < 2 or value[0] != value[-1] or value[0] not in "'\"":
        return value
    return value[1:-1].replace(f"\\{value[0]}", value[0]).replace("\\${", "${")


def typed(value: Any) -> str:
    """A plain value as it is typed behind a key: the entries of a list in brackets."""
    return f"[{','.join(map(str, value))}]" if isinstance(value, list | tuple) else str(value)
