"""The runs behind the notes of the lab, in one file: ``runs.parquet``, a line for each run.

Columns are the figures of its evaluation, ``curve.NAME`` (a list, a value for each evaluation on
the way) and, as JSON, what is nested. Parquet and not CSV, because whole numbers, fractions,
absent values and lists come back as what they were, and a column is read without the others; any
table reader opens it::

    python -m docs.lab.data                       # names of the rows, and their seeds
    python -m docs.lab.data export OUT ROW ...    # as OUT/ROW/seedN.json, for make report and plot
    python -m docs.lab.data add FOLDER            # takes in FOLDER/ROW/seedN.json of make results
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.results.rows import ResultRow, parse_published

FILE: Final = Path(__file__).parent / "runs.parquet"
CURVE: Final = "curve."
NESTED: Final = "json."
Content = Mapping[str, Any]


def load(path: Path = FILE) -> dict[str, dict[int, dict[str, Any]]]:
    """What was published of every run: ``{row: {seed: content of its seedN.json}}``."""
    rows: dict[str, dict[int, dict[str, Any]]] = {}
    for line in pq.read_table(path).to_pylist():
        rows.setdefault(line.pop("row"), {})[line.pop("seed")] = _content(line)
    return rows


def load_rows(path: Path = FILE) -> dict[str, ResultRow]:
    """The same as rows of results, by name."""
    return {
        name: ResultRow(
            name,
            tuple(parse_published(path, seeds[seed]) for seed in sorted(seeds)),
        )
        for name, seeds in load(path).items()
    }


def save(rows: Mapping[str, Mapping[int, Content]], path: Path = FILE) -> None:
    """Writes the file anew."""
    lines = [
        {"row": row, "seed": seed} | _line(rows[row][seed])
        for row in sorted(rows)
        for seed in sorted(rows[row])
    ]
    names = dict.fromkeys(name for line in lines for name in line)
    table = pa.Table.from_pylist([{name: line.get(name) for name in names} for line in lines])
    pq.write_table(table, path, compression="zstd", compression_level=19)


def read_folder(folder: Path) -> dict[str, dict[int, Content]]:
    """``folder/ROW/seedN.json`` of every row, as ``make results`` writes them."""
    rows: dict[str, dict[int, Content]] = {}
    for file in sorted(folder.glob("*/seed*.json")):
        number = int(file.stem.removeprefix("seed"))
        rows.setdefault(file.parent.name, {})[number] = json.loads(file.read_text())
    return rows


def export(names: Sequence[str], out: Path, path: Path = FILE) -> None:
    """Writes rows as ``out/ROW/seedN.json``.

    Raises:
        KeyError: The file holds no such row.
    """
    rows = load(path)
    for name in names:
        (out / name).mkdir(parents=True, exist_ok=True)
        for seed, content in rows[name].items():
            (out / name / f"seed{seed}.json").write_text(json.dumps(content) + "\n")


def _line(content: Content) -> dict[str, Any]:
    """Flat: lists of the curve are columns, what else is nested is JSON."""
    line: dict[str, Any] = {"json.keys": json.dumps(list(content))}
    for key, value in content.items():
        if key == "curve":
            line["json.curve"] = json.dumps(list(value))
            line |= {f"{CURVE}{name}": values for name, values in value.items()}
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
            content[key] = {name: line[f"{CURVE}{name}"] for name in names}
        elif (nested := line.get(f"{NESTED}{key}")) is not None:
            content[key] = json.loads(nested)
        else:
            content[key] = line[key]
    return content


def main(arguments: Sequence[str]) -> None:
    """The commands above."""
    match arguments:
        case []:
            for name, seeds in load().items():
                print(name, *seeds)  # noqa: T201 - a command's output
        case ["export", out, *names]:
            export(names, Path(out))
        case ["add", folder]:
            held = load() if FILE.is_file() else {}
            added = read_folder(Path(folder))
            save({name: held.get(name, {}) | added.get(name, {}) for name in {*held, *added}})
        case _:
            sys.exit("usage: python -m docs.lab.data [export OUT ROW ... | add FOLDER]")


if __name__ == "__main__":
    main(sys.argv[1:])
