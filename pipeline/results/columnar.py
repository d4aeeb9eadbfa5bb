"""Published runs in one Parquet file, a line for each run.

Columns are what names a run (its keys), the figures of its evaluation, ``curve.NAME`` (a list, a
value for each evaluation on the way) and, as JSON, what is nested. Parquet and not CSV, because
whole numbers, fractions, absent values and lists come back as what they were, and a column is read
without the others; any table reader opens it.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from envs.one_line import text_of
from pipeline.files.run_files import RunDirectoryError, write_atomically

CURVE: Final = "curve."
NESTED: Final = "json."
Content = Mapping[str, Any]
Keys = tuple[Any, ...]


def save(names: Sequence[str], runs: Mapping[Keys, Content], path: Path) -> None:
    """Writes the file anew, its lines in the order of their keys.

    Args:
        names: Of the keys, which are the first columns.
        runs: What is published of each run (``EvaluatedRun.published``), by its keys.
        path: Of the file.
    """
    lines = [dict(zip(names, keys, strict=True)) | _line(runs[keys]) for keys in sorted(runs)]
    columns = dict.fromkeys(name for line in lines for name in line)
    table = pa.Table.from_pylist([{name: line.get(name) for name in columns} for line in lines])
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd", compression_level=19)
    write_atomically(path, buffer.getvalue())


def load(names: Sequence[str], path: Path) -> dict[Keys, dict[str, Any]]:
    """What :func:`save` wrote, as it was.

    Raises:
        RunDirectoryError: If the file is damaged, or is none of these.
    """
    try:
        lines = pq.read_table(path).to_pylist()
        return {tuple(line.pop(name) for name in names): _content(line) for line in lines}
    except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise RunDirectoryError(
            f"{path} is damaged, or no file of published runs ({text_of(error)}); restore it, "
            "or remove it and publish again"
        ) from error


def _line(content: Content) -> dict[str, Any]:
    """Flat: lists of the curve are columns, what else is nested is JSON."""
    line: dict[str, Any] = {"json.keys": json.dumps(list(content))}
    for key, value in content.items():
        if key == "curve":
            line["json.curve"] = json.dumps(list(value))
            for name, values in value.items():
                # Lines whose mappings have other keys would each be given those of all.
                nested = any(isinstance(entry, dict) for entry in values)
                line[f"{NESTED}{CURVE}{name}" if nested else f"{CURVE}{name}"] = (
                    json.dumps(values) if nested else values
                )
        elif isinstance(value, dict | list):
            line[f"{NESTED}{key}"] = json.dumps(value)
        else:
            line[key] = value
    return line


def _content(line: Mapping[str, Any]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for key in json.loads(line["json.keys"]):
        if key == "curve":
            names = json.loads(line["json.curve"])
            content[key] = {name: _curve(line, name) for name in names}
        elif (nested := line.get(f"{NESTED}{key}")) is not None:
            content[key] = json.loads(nested)
        else:
            content[key] = line[key]
    return content


def _curve(line: Mapping[str, Any], name: str) -> Any:
    nested = line.get(f"{NESTED}{CURVE}{name}")
    return line[f"{CURVE}{name}"] if nested is None else json.loads(nested)
