"""Runs of one row of the tables, one per seed, as they lie below a folder of runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from configs.schema import Config
from pipeline.evaluate_run import load_evaluation
from pipeline.run_dir import ALARMS, EVALUATION, LEARNING_CURVE, RunDirectoryError, load_config

SEED = "seed"
DIGITS = 6
"""Significant digits of published curves."""


@dataclass(frozen=True)
class Seed:
    """One evaluated run."""

    run_dir: Path
    config: Config
    evaluation: Mapping[str, Any]
    curve: tuple[Mapping[str, Any], ...]
    """Rows of the learning curve; empty for a run without a curve."""
    alarms: tuple[Mapping[str, Any], ...]

    @property
    def seed(self) -> int:
        """Of the run."""
        return int(self.config.seed)

    def published(self) -> dict[str, Any]:
        """Everything that a reader of the results can check, without paths of this machine."""
        made_from = {**self.evaluation["made_from"]}
        made_from["run"] = self.run_dir.name
        made_from["demos"] = Path(made_from["demos"]).name
        columns = {key: None for row in self.curve for key in row}
        return {
            **self.evaluation,
            "made_from": made_from,
            "alarms": list(self.alarms),
            "curve": {key: [_short(row.get(key)) for row in self.curve] for key in columns},
        }


@dataclass(frozen=True)
class ResultRow:
    """A row of the tables: one recipe, several seeds."""

    name: str
    seeds: tuple[Seed, ...]

    def figures(self, key: str) -> list[float]:
        """One number of every seed's evaluation."""
        return [float(seed.evaluation[key]) for seed in self.seeds]

    @property
    def median(self) -> Seed:
        """The seed in the middle by return: what a user of the recipe may expect."""
        ordered = sorted(self.seeds, key=lambda seed: float(seed.evaluation["return_mean"]))
        return ordered[len(ordered) // 2]


def load_rows(folder: Path) -> list[ResultRow]:
    """Reads ``folder/ROW/seedN`` of all rows; runs that are not evaluated yet are left out.

    Raises:
        RunDirectoryError: If there is no evaluated run, or one cannot be read.
    """
    rows = []
    for row_dir in sorted(path for path in folder.glob("*") if path.is_dir()):
        runs = sorted(run for run in row_dir.glob(f"{SEED}*") if (run / EVALUATION).is_file())
        seeds = sorted((load_seed(run) for run in runs), key=lambda seed: seed.seed)
        if seeds:
            rows.append(ResultRow(row_dir.name, tuple(seeds)))
    if not rows:
        raise RunDirectoryError(
            f"{folder} holds no evaluated run ROW/{SEED}N/{EVALUATION}; make them with: make rows"
        )
    return rows


def load_seed(run_dir: Path) -> Seed:
    """Reads one evaluated run.

    Raises:
        RunDirectoryError: If it has no evaluation or configuration.
    """
    return Seed(
        run_dir,
        load_config(run_dir),
        load_evaluation(run_dir),
        tuple(read_lines(run_dir / LEARNING_CURVE)),
        tuple(read_lines(run_dir / ALARMS)),
    )


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Rows of a JSON-lines file of a run; none if there is no such file."""
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


def _short(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
