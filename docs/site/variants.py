"""What a page of a method shows of its YAML files and of the published results."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import yaml

from docs.site.places import DOCS, ROOT
from docs.site.tables import table
from envs import find_task
from envs.reference import Column, Reference
from pipeline.results.rows import load_published
from pipeline.results.run_tables import SPENT, spent
from pipeline.results.runs import RunGroup

VARIANTS = ROOT / "configs" / "variant"
RESULTS = DOCS / "results"
DEVIATION = "Deviation:"


def variant_files() -> dict[str, Path]:
    """Every variant's YAML by its name."""
    return {path.stem: path for path in sorted(VARIANTS.glob("*.yaml"))}


def content(path: Path) -> Mapping[str, Any]:
    """Values of a variant's file."""
    found = yaml.safe_load(path.read_text())
    return found if isinstance(found, dict) else {}


def parents(name: str) -> list[str]:
    """The variants that a variant stands on, nearest first."""
    files = variant_files()
    named = content(files[name]).get("defaults", [])
    above = [entry for entry in named if isinstance(entry, str) and entry in files]
    return [ancestor for parent in above for ancestor in (parent, *parents(parent))]


def comments(path: Path) -> list[str]:
    """Comments of a YAML file as sentences: lines of one block are joined, a deviation parts."""
    blocks: list[str] = []
    joined = False
    for line in path.read_text().splitlines():
        found = re.match(r"^\s*# (?!@package)(.*)$", line)
        if found is None:
            joined = False
        elif joined and not found[1].startswith(DEVIATION):
            blocks[-1] += f" {found[1]}"
        else:
            blocks.append(found[1])
            joined = True
    return blocks


def departures(names: Sequence[str]) -> str:
    """What the files of these variants, and of their parents, say departs from the paper."""
    files = variant_files()
    chain = dict.fromkeys([*names, *(parent for name in names for parent in parents(name))])
    found = [
        f"- `{name}`: {text.removeprefix(DEVIATION).strip()}"
        for name in chain
        for text in comments(files[name])
        if text.startswith(DEVIATION)
    ]
    none = "The files of this method name none; what a preset changes is in its own file."
    return "\n".join(found) or none


def yaml_of(names: Sequence[str]) -> str:
    """The files of these variants, shown by pymdownx.snippets."""
    blocks = [
        f'```yaml title="configs/variant/{name}.yaml"\n--8<-- "configs/variant/{name}.yaml"\n```'
        for name in names
    ]
    return "\n\n".join(blocks)


def results(names: Sequence[str]) -> str:
    """Rows of the published results that these variants made, beside the paper's."""
    rows = [row for row in load_published(RESULTS) if made_by(row) in names]
    if not rows:
        return "No row of this method is published yet: `make rows ROWS=NAME` makes one."
    reference = find_task("door").reference
    columns = _columns(reference)
    head = ["row", "seeds", *SPENT.values(), *(column.header for column in columns)]
    return table(head, (line for row in rows for line in _lines(row, columns, reference)))


def made_by(row: RunGroup) -> str:
    """The variant of which a row of results is."""
    return row.runs[0].evaluation.made_from.variant


def _columns(reference: Reference | None) -> list[Column]:
    if reference is None:
        return []
    found = {c.key: c for columns in reference.tables.values() for c in columns}
    wanted = ("return_mean", "share_gt_0_2", "share_gt_1_35", "success_at_end")
    return [found[key] for key in wanted]


def _lines(
    row: RunGroup, columns: Sequence[Column], reference: Reference | None
) -> Iterable[list[str]]:
    yield [
        f"`{row.name}`",
        str(len(row.runs)),
        *spent(row.evaluations),
        *(_figure(fmean(row.figures(column.key)), column) for column in columns),
    ]
    published = reference.rows.get(row.name, {}) if reference else {}
    if published:
        cells = (_figure(published.get(column.key), column) for column in columns)
        yield [
            f"the {reference.source if reference else ''}'s `{row.name}`",
            "1",
            *["-"] * len(SPENT),
            *cells,
        ]


def _figure(value: float | None, column: Column) -> str:
    if value is None:
        return ""
    return f"{100.0 * value:.1f} %" if column.percent else f"{value:.1f}"
