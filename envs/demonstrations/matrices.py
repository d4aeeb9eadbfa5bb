"""Observations and actions of a file as the matrices that a task has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import one_line
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.flattening import flatten_columns, looks_like_image, named_columns
from envs.demonstrations.schema import DemoSchema
from envs.flatten import ROOT
from envs.scaling import from_unit, to_unit

ROUNDING: Final = 1e-6
"""An action entry no further beyond its bound was rounded, not meant to be there."""
_FLOAT32_MAX: Final = float(np.finfo(np.float32).max)


def numbers(value: ArrayLike, name: str, where: str, *, single: bool = True) -> NDArray[np.float64]:
    """``value`` as finite float64.

    Args:
        value: whatever a file holds.
        name: of the array, for the message.
        where: file and episode, for the message.
        single: the numbers will be stored as float32, and must not overflow it.

    Raises:
        DemonstrationError: ragged, no real numbers, NaN, infinite or too large.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise DemonstrationError(
            where,
            f"{name} is ragged ({one_line(error)})",
            "Store one rectangular array per episode",
        ) from error
    if array.dtype.kind not in "fiub":
        raise DemonstrationError(
            where, f"{name} has dtype {array.dtype}", "Store real numbers, e.g. float32"
        )
    result = array.astype(np.float64)
    if not np.isfinite(result).all():
        index, found = _first(result, ~np.isfinite(result))
        raise DemonstrationError(
            where,
            f"{name}{index} is {found}",
            "Remove or repair this episode: NaN and infinity poison every later update",
        )
    if single and result.size and np.abs(result).max() > _FLOAT32_MAX:
        index, found = _first(result, np.abs(result) > _FLOAT32_MAX)
        raise DemonstrationError(
            where, f"{name}{index} is {found}, infinite in float32", "Remove or repair this episode"
        )
    return result


def observation_matrix(
    value: ArrayLike | Mapping[str, Any], where: str, schema: DemoSchema, notes: Notes
) -> NDArray[np.float32]:
    """Observations [rows, O] of the task.

    Args:
        value: [rows, ...] or several of these by name.
        where: file and episode, for the error messages.
        schema: of the task.
        notes: take down what is left out.

    Raises:
        DemonstrationError: an image, a missing key, another width, or no finite numbers.
    """
    nested = isinstance(value, Mapping | tuple)
    if not nested and any(leaf.path == () for leaf in schema.discrete):
        value = {ROOT: value}
    if isinstance(value, Mapping | tuple):
        value = _selected(value, where, schema, notes)
    array = numbers(value, "observations", where)
    _refuse_image("observations", value, where, schema)
    widths = schema.widths
    matrix = _matrix(array, "observations", where, widths, schema)
    if matrix.shape[1] != schema.observation_size:
        notes.add(Kind.COLUMNS, 1, f"{where}, {matrix.shape[1]} columns")
    return matrix[:, : schema.observation_size].astype(np.float32)


def action_matrix(
    value: ArrayLike, where: str, schema: DemoSchema, *, normalised: bool = False
) -> NDArray[np.float64]:
    """Actions [T, A] in the task's units; entries beyond [-1, 1] stay for whoever clips them.

    Args:
        value: [T, ...].
        where: file and episode, for the error messages.
        schema: of the task.
        normalised: they are in [-1, 1] already.

    Raises:
        DemonstrationError: structured actions, another width, or an entry beyond the bounds.
    """
    if isinstance(value, Mapping):
        raise DemonstrationError(
            where, f"has structured actions ({', '.join(map(str, value))})", "Store one array"
        )
    recorded = _matrix(
        numbers(value, "actions", where), "actions", where, (schema.action_size,), schema
    )
    low, high = (
        np.broadcast_to(bound, recorded.shape) for bound in _action_bounds(schema, normalised)
    )
    rescaled = not normalised and schema.action_low is not None
    actions = to_unit(recorded, low, high) if rescaled else recorded
    magnitude = np.abs(actions)
    rounded = (magnitude > 1.0) & (magnitude <= 1.0 + ROUNDING)
    actions = np.where(rounded, np.sign(actions), actions)
    if magnitude.size and magnitude.max() > schema.action_bound + ROUNDING:
        row, entry = np.unravel_index(int(magnitude.argmax()), magnitude.shape)
        raise DemonstrationError(
            where,
            f"has an action entry of magnitude {magnitude.max():.3g}, beyond "
            f"{schema.action_bound}: actions[{row}, {entry}] is {recorded[row, entry]:.4g}, "
            f"its bounds are {low[row, entry]:.4g} and {high[row, entry]:.4g}",
            "Actions must be in the units of the task's action space (slight excess is clipped)",
        )
    return actions


def in_file_units(actions: NDArray[np.float32], schema: DemoSchema | None) -> NDArray[np.float32]:
    """Actions [T, A] of an episode in the units in which the schema's files hold them."""
    if schema is None or schema.action_low is None:
        return actions
    return from_unit(actions, *_action_bounds(schema, normalised=False)).astype(np.float32)


def _action_bounds(schema: DemoSchema, normalised: bool) -> tuple[Any, Any]:
    if normalised or schema.action_low is None or schema.action_high is None:
        return -1.0, 1.0
    return schema.action_low, schema.action_high


def _selected(
    value: Mapping[str, Any] | tuple[Any, ...], where: str, schema: DemoSchema, notes: Notes
) -> NDArray[np.float64]:
    columns = value if isinstance(value, Mapping) else {str(i): v for i, v in enumerate(value)}
    named = named_columns(columns, where)
    wanted = tuple(named) if schema.observation_keys is None else schema.observation_keys
    missing = [key for key in wanted if key not in named]
    if missing or not wanted:
        raise DemonstrationError(
            where,
            f"lacks the observation {', '.join(missing)} (found: {', '.join(named) or 'nothing'})",
            "Name the keys that the file has (the schema's observation_keys)",
        )
    unused = [key for key in named if key not in wanted]
    notes.add(Kind.KEYS_UNUSED, int(bool(unused)), f"{where}: {', '.join(unused)}")
    for key in wanted:
        _refuse_image(key, named[key], where, schema)
    return flatten_columns(
        {key: named[key] for key in wanted}, discrete=schema.discrete, where=where
    )


def _refuse_image(name: str, value: Any, where: str, schema: DemoSchema) -> None:
    if looks_like_image(np.asarray(value)):
        raise DemonstrationError(
            where,
            f"{name} is a picture (uint8 {list(np.shape(value))})",
            f"Policies here take numbers of {schema.describes}: choose other keys "
            "(the schema's observation_keys)",
        )


def _matrix(
    array: NDArray[np.float64], name: str, where: str, widths: tuple[int, ...], schema: DemoSchema
) -> NDArray[np.float64]:
    matrix = array.reshape(len(array), -1) if array.ndim and array.size else array
    # A vector is a column only where the task has one: else it is a row that lost its brackets.
    if matrix.ndim != 2 or matrix.shape[1] not in widths:
        expected = " or ".join(f"[T, {width}]" for width in widths)
        raise DemonstrationError(
            where,
            f"{name} has shape {list(array.shape)}, expected {expected}",
            f"Only demonstrations of {schema.describes} fit; name the task of yours (TASK=)",
        )
    return matrix


def _first(array: NDArray[np.float64], chosen: NDArray[np.bool_]) -> tuple[list[int], float]:
    index = tuple(int(i) for i in np.argwhere(chosen)[0])
    return list(index), float(array[index])
