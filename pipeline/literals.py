"""Values of a command line that are names and paths, and mean themselves whatever they hold.

Of other values a comma is a sweep to Hydra and an equals sign an error, and ``a: b`` is a mapping
to YAML; folders have such names.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Any, Final

TASK_KEY: Final = "task.name"
LITERAL: Final = frozenset({"run_dir", "resume", TASK_KEY, "demos.source", "cache_dir"})
"""Keys of such values."""
PLAIN: Final = re.compile(r"(?!(?:true|false|null|nan|inf)$)[a-z_./][\w./:-]*", re.IGNORECASE)
"""A string that means itself to Hydra and to YAML, unquoted."""


def literal(value: str) -> str:
    """What a value of :data:`LITERAL` means: itself, or what stands between its quotes."""
    if len(value) < 2 or value[0] != value[-1] or value[0] not in "'\"":
        return value
    return value[1:-1].replace(f"\\{value[0]}", value[0]).replace("\\${", "${")


def typed(value: Any) -> str:
    """A value as a command line types it: Hydra and YAML read the same from it."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_within(one)}' for key, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{','.join(typed(one) for one in value)}]"
    return str(value)


def word(override: str) -> str:
    """``key=value`` as one word of a shell."""
    return shlex.quote(override) if re.search(r"[\s{}]", override) else override


def _within(value: Any) -> str:
    """A value within a mapping, where a string is quoted if it could be read as something else."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, list | tuple):
        return f"[{', '.join(_within(one) for one in value)}]"
    if isinstance(value, str) and not PLAIN.fullmatch(value):
        return f"'{value}'"
    return typed(value)
