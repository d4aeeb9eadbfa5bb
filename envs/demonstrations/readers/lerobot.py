"""A LeRobot dataset on disk: Parquet files below ``data/`` and their description in ``meta/``.

Versions 2 (a file per episode) and 3 (files of many episodes). Videos are not read.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations import limits
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import DAMAGED, one_line, read_json_file, require_readable
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode

_INFO = Path("meta") / "info.json"
_PICTURES = ("image", "video")
_OBSERVATION = "observation."
_EPISODE, _FRAME = "episode_index", "frame_index"
# By its path: importing it would import an extra.
_PROBE = str(Path(limits.__file__).with_name("parquet_probe.py"))
_OPTIONAL = {"rewards": "next.reward", "success": "next.success"}


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Episodes by their index.

    ``next.done`` marks the end and does not tell a terminal state from a time limit. The
    observation after the last action is not part of the format.
    """
    features = _features(path)
    observed = [key for key in features if key.startswith(_OBSERVATION)]
    optional = [key for key in _OPTIONAL.values() if key in features]
    table = _table(path, [*observed, "action", _EPISODE, _FRAME, *optional])
    for episode in np.unique(table[_EPISODE]):
        where = f"{path}, episode {episode}"
        rows = np.flatnonzero(table[_EPISODE] == episode)
        rows = rows[np.argsort(table[_FRAME][rows], kind="stable")]
        if not np.array_equal(table[_FRAME][rows], np.arange(len(rows))):
            raise DemonstrationError(
                where, "has missing or repeated frames", "Download the dataset again"
            )
        if schema.terminated is None:
            notes.add(Kind.ENDS_UNTOLD, 1, where)
        told: dict[str, Any] = {n: table[k][rows] for n, k in _OPTIONAL.items() if k in table}
        raw = RawEpisode(
            observations={key: table[key][rows] for key in observed},
            actions=table["action"][rows],
            **told,
        )
        yield Record(raw, where)


def _features(path: Path) -> list[str]:
    info = path / _INFO
    content = read_json_file(info, "description")
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, dict) or not all(isinstance(f, dict) for f in features.values()):
        raise DemonstrationError(info, "lacks features", DAMAGED)
    missing = [key for key in ("action", _EPISODE, _FRAME) if key not in features]
    if missing:
        raise DemonstrationError(info, f"names no feature {', '.join(missing)}", DAMAGED)
    return [key for key, feature in features.items() if feature.get("dtype") not in _PICTURES]


def _table(path: Path, columns: list[str]) -> dict[str, NDArray[Any]]:
    """Columns of all files, one after the other."""
    files = sorted((path / "data").glob("**/*.parquet"))
    if not files:
        raise DemonstrationError(path, "holds no data/*/*.parquet", "Download the dataset whole")
    parts = [_columns(file, columns) for file in files]
    try:
        return {key: np.concatenate([part[key] for part in parts]) for key in columns}
    except ValueError as error:
        raise DemonstrationError(
            path, f"has files that differ in shape ({one_line(error)})", DAMAGED
        ) from error


def _columns(file: Path, columns: list[str]) -> dict[str, NDArray[Any]]:
    try:
        import pyarrow.parquet  # noqa: PLC0415 - an extra: most users never need it
    except ImportError as error:
        raise DemonstrationError(
            file, "needs the package pyarrow", "pip install 'bc-sac[lerobot]'"
        ) from error
    require_readable(file, _PROBE)
    try:
        with pyarrow.parquet.ParquetFile(file) as opened:
            declared = sum(
                opened.metadata.row_group(i).total_byte_size for i in range(opened.num_row_groups)
            )
            if declared > max(limits.FREE_BYTES, file.stat().st_size * limits.MAX_EXPANSION):
                raise DemonstrationError(file, f"declares {declared:,} bytes", DAMAGED)
            table = opened.read(columns=columns)
        return {key: _array(table.column(key), f"{file}, {key}") for key in columns}
    except DemonstrationError:
        raise
    # Arrow's errors are of many kinds, and a missing column is a KeyError.
    except Exception as error:
        raise DemonstrationError(file, f"cannot be read ({one_line(error)})", DAMAGED) from error


def _array(column: Any, where: str) -> NDArray[Any]:
    """A column of numbers [rows], or of lists of equal length [rows, size]."""
    if column.null_count:
        raise DemonstrationError(where, f"has {column.null_count} empty cells", "Fill or drop them")
    values, shape = column.combine_chunks(), [len(column)]
    while hasattr(values.type, "value_type"):
        lengths = np.unique(np.diff(_offsets(values)))
        if len(lengths) != 1:
            raise DemonstrationError(where, "has lists of different lengths", DAMAGED)
        shape.append(int(lengths[0]))
        values = values.flatten()
    if values.null_count:
        raise DemonstrationError(where, f"has {values.null_count} empty entries", "Fill them")
    return np.asarray(values.to_numpy(zero_copy_only=False)).reshape(shape)


def _offsets(lists: Any) -> NDArray[Any]:
    if hasattr(lists.type, "list_size"):
        return np.arange(len(lists) + 1) * lists.type.list_size
    return np.asarray(lists.offsets)


READER = Reader(
    form="a local LeRobot dataset (meta/info.json, data/*/*.parquet)",
    fits=lambda path: (path / _INFO).is_file(),
    read=read,
)
