"""Nested settings by dotted key, as a command line names them: ``loss.bc_weight.init``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def flatten(values: Mapping[str, Any], group: str = "") -> dict[str, Any]:
    """Values by dotted key; an empty mapping is a value.

    Args:
        values: Mappings within are groups.
        group: In which they are themselves.
    """
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = join(group, key)
        found |= flatten(value, name) if isinstance(value, Mapping) and value else {name: value}
    return found


def names(values: Mapping[str, Any], group: str = "") -> Iterator[str]:
    """Dotted keys of all values and of the groups that they are in."""
    for key, value in values.items():
        name = join(group, key)
        yield name
        if isinstance(value, Mapping):
            yield from names(value, name)


def nest(key: str, value: Any) -> dict[str, Any]:
    """The mapping in which a value has this dotted key."""
    found: dict[str, Any] = {}
    put(found, key, value)
    return found


def put(values: dict[str, Any], key: str, value: Any) -> None:
    """Sets the value of a dotted key; groups that are missing are made."""
    *groups, last = key.split(".")
    for group in groups:
        values = values.setdefault(group, {})
    values[last] = value


def join(group: str, key: str) -> str:
    """The dotted key of a key in a group; the outermost group has no name."""
    return f"{group}.{key}" if group else str(key)
