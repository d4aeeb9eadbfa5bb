"""The runs behind the notes of the lab, in one file: ``runs.parquet``, a line for each run.

Its columns: :mod:`pipeline.results.columnar`; any table reader opens it::

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

from pipeline.results import columnar
from pipeline.results.reading import parse_published
from pipeline.results.runs import RunGroup

FILE: Final = Path(__file__).parent / "runs.parquet"
KEYS: Final = ("row", "seed")
Content = columnar.Content


def load(path: Path = FILE) -> dict[str, dict[int, dict[str, Any]]]:
    """What was published of every run: ``{row: {seed: content of its seedN.json}}``."""
    rows: dict[str, dict[int, dict[str, Any]]] = {}
    for (row, seed), content in columnar.load(KEYS, path).items():
        rows.setdefault(row, {})[seed] = content
    return rows


def load_rows(path: Path = FILE) -> dict[str, RunGroup]:
    """The same as rows of results, by name."""
    return {
        name: RunGroup(
            name,
            tuple(parse_published(path, seeds[seed]) for seed in sorted(seeds)),
        )
        for name, seeds in load(path).items()
    }


def save(rows: Mapping[str, Mapping[int, Content]], path: Path = FILE) -> None:
    """Writes the file anew."""
    runs = {(row, seed): content for row, seeds in rows.items() for seed, content in seeds.items()}
    columnar.save(KEYS, runs, path)


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
