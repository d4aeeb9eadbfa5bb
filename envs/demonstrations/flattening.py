"""Structured observations of a file as one vector per step.

The order must agree with what the environments of `envs.library` write: keys sorted by their path,
joined with "/"; C order inside an array; a discrete value as a one-hot vector.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.limits import MAX_DEPTH

SEPARATOR = "/"


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
    discrete: Mapping[str, int] | None = None,
    where: str = "observations",
) -> NDArray[np.float64]:
    """One matrix [T, O] of all arrays, in the order of the module's docstring.

    Args:
        columns: arrays [T, ...] by name; mappings and tuples of these may be nested.
        discrete: how many values 0, 1, ... a key takes, by path; its integers become one-hot.
        where: file and episode, for the error messages.

    Raises:
        DemonstrationError: the arrays differ in T, hold no numbers, or a discrete value is outside
            its range.
    """
    sizes = discrete or {}
    named = {
        path: _one_hot(f"{where}, {path}", values, sizes[path]) if path in sizes else values
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


def _one_hot(place: str, values: NDArray[Any], size: int) -> NDArray[np.float64]:
    whole = np.asarray(values).reshape(len(values), -1)
    inside = (whole == np.floor(whole)) & (whole >= 0) & (whole < size)
    if whole.shape[1] != 1 or not inside.all():
        found = whole.ravel()[int(np.argmin(inside))]
        raise DemonstrationError(
            place,
            f"holds {found}, expected one whole number of 0..{size - 1} per step",
            "Repair the file, or name the right number of values",
        )
    return np.eye(size)[whole[:, 0].astype(np.int64)]
