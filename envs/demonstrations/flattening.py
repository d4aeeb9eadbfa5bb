"""Structured observations of a file as one vector per step, in the order of `envs.flatten`.

A file need not say what spaces its arrays are from; the task's integers (`Leaf`) are written by the
same code as an environment's, and a property test holds the two together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.limits import MAX_DEPTH
from envs.flatten import SEPARATOR, Leaf


def named_columns(
    columns: Mapping[str, Any], where: str = "observations"
) -> dict[str, NDArray[Any]]:
    """Leaves of nested mappings and tuples of arrays by path (``goal/position``), sorted by it.

    Raises:
        DemonstrationError: the nesting has no end.
    """
    return dict(sorted(_leaves(columns, "", MAX_DEPTH, where)))


def flatten_columns(
    columns: Mapping[str, Any],
    *,
    discrete: Sequence[Leaf] = (),
    where: str = "observations",
) -> NDArray[np.float64]:
    """One matrix [T, O] of all arrays.

    Args:
        columns: arrays [T, ...] by name; mappings and tuples of these may be nested.
        discrete: arrays of integers, which become one-hot where a file holds the integers.
        where: file and episode, for the error messages.

    Raises:
        DemonstrationError: the arrays differ in T, hold no numbers, or a discrete value is outside
            its range.
    """
    integers = {leaf.name: leaf for leaf in discrete}
    named = {
        path: _one_hot(f"{where}, {path}", values, integers[path]) if path in integers else values
        for path, values in named_columns(columns, where).items()
    }
    steps = {path: len(values) if values.ndim else 0 for path, values in named.items()}
    if len(set(steps.values())) != 1:
        lengths = ", ".join(f"{path} {count}" for path, count in steps.items()) or "nothing"
        raise DemonstrationError(
            where,
            f"has observation arrays of different lengths ({lengths})",
            "Store one row per step in each",
        )
    count = next(iter(steps.values()))
    return np.concatenate(
        [_rows(f"{where}, {path}", values).reshape(count, -1) for path, values in named.items()],
        axis=1,
    )


def looks_like_image(values: NDArray[Any]) -> bool:
    """Whether [T, H, W] or [T, H, W, C] of bytes: pixels, which no policy here can take."""
    return bool(values.dtype == np.uint8 and values.ndim >= 3)


def _leaves(value: Any, path: str, depth: int, where: str) -> Iterator[tuple[str, NDArray[Any]]]:
    if depth == 0:
        raise DemonstrationError(where, "is nested too deeply", f"At most {MAX_DEPTH} levels")
    if isinstance(value, tuple):
        value = {str(index): entry for index, entry in enumerate(value)}
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _leaves(
                entry, f"{path}{SEPARATOR}{key}" if path else str(key), depth - 1, where
            )
    else:
        yield path, np.asarray(value)


def _rows(place: str, values: NDArray[Any]) -> NDArray[np.float64]:
    if values.dtype.kind not in "fiub":
        raise DemonstrationError(
            place, f"has dtype {values.dtype}", "Store real numbers, e.g. float32"
        )
    return values.astype(np.float64)


def _one_hot(place: str, values: NDArray[Any], leaf: Leaf) -> NDArray[Any]:
    found, entries = _rows(place, values).reshape(len(values), -1), len(leaf.values)
    if found.shape[1] == leaf.size != entries:
        return found  # as environments write it
    ranges = zip(leaf.first, leaf.values, strict=True)
    between = ", ".join(f"{first}..{first + count - 1}" for first, count in ranges)
    expected = f"{'one whole number' if entries == 1 else f'{entries} whole numbers'} of {between}"
    remedy = "Repair the file, or name the right values (the schema's discrete)"
    if found.shape[1] != entries:
        raise DemonstrationError(
            place, f"holds {found.shape[1]} numbers per step, expected {expected}", remedy
        )
    inside = (found == np.floor(found)) & leaf.holds(found)
    if not inside.all():
        strange = found[~inside].flat[0]
        raise DemonstrationError(place, f"holds {strange:g}, expected {expected} per step", remedy)
    encoded = np.empty((len(found), leaf.size), np.float32)
    leaf.write(found.astype(np.int64), encoded)
    return encoded
