"""States of plain values, nested by name, as flat arrays and back: what a checkpoint can hold.

Nothing is pickled, so that reading a checkpoint runs no code.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
INTEGER_BYTES: Final = 24
"""Of an integer, with its sign: generators of random numbers count in 128 bits."""
UNSIGNED_BYTES: Final = 16
"""Of an integer in checkpoints of before."""
TEXT_BYTES: Final = 64
"""Of a text, in UTF-8; what is beyond it is refused."""


def as_arrays(state: Any, path: str = "") -> dict[str, Array]:
    """The values of ``state`` by their paths (``car.speed``), as copies whose shapes are fixed.

    Args:
        state: an array, a number, True or False, a text, or a mapping of names to such.
        path: of ``state`` itself.

    Raises:
        TypeError: a value is of another kind; the message names its path.
    """
    if isinstance(state, Mapping):
        found: dict[str, Array] = {}
        for key, value in state.items():
            found |= as_arrays(value, f"{path}.{key}" if path else str(key))
        return found
    return {path: _as_array(state, path)}


def like(template: Any, arrays: Mapping[str, Array], path: str = "") -> Any:
    """The state that `as_arrays` took apart, made as ``template`` is.

    Args:
        template: a state of the same names and kinds.
        arrays: by path. What they lack stays as it is in the template.
        path: of ``template`` itself.
    """
    if isinstance(template, Mapping):
        return {
            key: like(value, arrays, f"{path}.{key}" if path else str(key))
            for key, value in template.items()
        }
    array = arrays.get(path)
    return template if array is None else _as_kind(template, array)


def _as_array(value: Any, path: str) -> Array:
    if isinstance(value, bool | np.bool_ | float | np.floating | np.integer):
        return np.asarray(value)
    if isinstance(value, int):
        return np.frombuffer(value.to_bytes(INTEGER_BYTES, "little", signed=True), np.uint8).copy()
    if isinstance(value, str):
        text = value.encode()
        if len(text) <= TEXT_BYTES and "\0" not in value:
            return np.frombuffer(text.ljust(TEXT_BYTES, b"\0"), np.uint8).copy()
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value.copy()
    raise TypeError(
        f"{path or 'it'} is {_told(value)}; a state is of arrays of numbers, numbers, True and "
        f"False, texts of at most {TEXT_BYTES} bytes, and mappings of names to these"
    )


def _as_kind(template: Any, array: Array) -> Any:
    if isinstance(template, np.ndarray):
        return array.copy()
    if isinstance(template, np.generic):
        return array.astype(template.dtype)[()]
    if isinstance(template, str):
        return array.tobytes().rstrip(b"\0").decode()
    if isinstance(template, bool | float):
        return array.item()
    return int.from_bytes(array.tobytes(), "little", signed=len(array) > UNSIGNED_BYTES)


def _told(value: Any) -> str:
    return f"an array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
