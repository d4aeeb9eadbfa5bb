"""Published results of a task, to stand beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A column of a task's published tables."""

    key: str
    """Of ``evaluation.json``."""
    header: str
    percent: bool = False


@dataclass(frozen=True)
class Reference:
    """Published rows to stand beside.

    Attributes:
        source: who published them.
        tables: columns by the table's title.
        rows: the published numbers by key of the column, by the row's name (a variant, or a variant
            and its imitation weight: ``bc_sac_0.1``).
        success: key of the column that is ``success_once`` under another name.
    """

    source: str
    tables: Mapping[str, tuple[Column, ...]]
    rows: Mapping[str, Mapping[str, float]]
    success: str = "success_once"
