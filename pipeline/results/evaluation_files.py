"""What ``make eval`` leaves: the summary, and beside it a row per episode and per control step."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import Task
from pipeline.act.metrics import Rollouts
from pipeline.files import again
from pipeline.files.run_files import EVALUATION, RunDirectoryError, as_json, write_atomically
from pipeline.results.evaluation import Evaluation

SUM = "sha256"
"""Key of an evaluation file: of all others and their values."""
EPISODES = "episodes.csv"
"""A row per episode of the evaluation."""
PROGRESS_CURVE = "progress.csv"
"""A row per control step: quantiles of the progress over the episodes that still run."""
QUANTILES = (0.1, 0.5, 0.9)
START = "start."
"""Begins the columns that say where an episode begins: ``start.KEY.x``, or ``start.KEY.0``."""
STAGE = "stage"
STRATEGY = "strategy"
NO_STAGE = "none"
DIGITS = 9
"""Significant digits: a float32 comes back as it was."""

Columns = Mapping[str, Sequence[Any]]
"""A table by column; all are equally long, and None is a cell without a value."""


@dataclass(frozen=True)
class RunEvaluation:
    """An evaluation of a run.

    Attributes:
        metrics: the content of ``evaluation.json``.
        episodes: a row per episode.
        progress: a row per control step; empty where the task tells no progress.
    """

    metrics: Mapping[str, Any]
    episodes: Columns
    progress: Columns

    def write(self, path: Path) -> None:
        """Writes the summary to ``path`` and the tables beside it, the summary last."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(beside(path, EPISODES), _as_csv(self.episodes))
        if self.progress:
            write_atomically(beside(path, PROGRESS_CURVE), _as_csv(self.progress))
        save_evaluation(path, self.metrics)


def beside(path: Path, table: str) -> Path:
    """Where a table of the evaluation ``path`` lies; another summary has tables of its own."""
    return path.with_name(table if path.name == EVALUATION else f"{path.stem}.{table}")


def episode_columns(task: Task, rollouts: Rollouts, seed: int) -> dict[str, list[Any]]:
    """A row per episode.

    Args:
        task: Whose episodes.
        rollouts: Of the episodes 0, 1, ... of the list with this ``seed``, E in all.
        seed: Of the list.

    Returns:
        ``episode``; ``start.*`` where the task numbers its starts; ``return``; ``steps``;
        ``success_once``, ``success_at_end``, ``steps_to_success`` (the first control step of
        success, from 1; None without one) and ``steps_in_success`` where it tells success;
        ``progress_max`` and ``progress_at_end`` where it tells progress; ``stage``, the last of its
        stages that the episode ever reached, where it has some.
    """
    count = len(rollouts.returns)
    found: dict[str, list[Any]] = {"episode": list(range(count))}
    if task.starts is not None:
        for key, values in task.starts(seed, 0, count).items():
            found |= _start_columns(task, key, values.reshape(count, -1).cpu().numpy())
    found["return"] = rollouts.returns.tolist()
    found["steps"] = rollouts.lengths.tolist()
    last = rollouts.lengths[:, None] - 1
    if rollouts.success is not None:
        once = np.asarray(rollouts.success.any(axis=1))
        first = (rollouts.success.argmax(axis=1) + 1).tolist()
        found["success_once"] = once.astype(int).tolist()
        found["success_at_end"] = _at(rollouts.success, last).astype(int).tolist()
        found["steps_to_success"] = [
            step if happened else None for step, happened in zip(first, once.tolist(), strict=True)
        ]
        found["steps_in_success"] = rollouts.success.sum(axis=1).tolist()
    if rollouts.progress is not None:
        found["progress_max"] = np.nanmax(rollouts.progress, axis=1).tolist()
        found["progress_at_end"] = _at(rollouts.progress, last).tolist()
    if rollouts.stages:
        found[STAGE] = _furthest(rollouts.stages)
    return found


def progress_columns(rollouts: Rollouts) -> dict[str, list[Any]]:
    """A row per control step, from 1: how many episodes still run, and quantiles of their progress.

    Empty where the task tells no progress.
    """
    if rollouts.progress is None:
        return {}
    running = np.isfinite(rollouts.progress).sum(axis=0)
    progress = rollouts.progress[:, running > 0]
    quantiles = np.nanquantile(progress, QUANTILES, axis=0)
    named = {f"q{100 * q:.0f}": row.tolist() for q, row in zip(QUANTILES, quantiles, strict=True)}
    steps = progress.shape[1]
    return {"step": list(range(1, steps + 1)), "running": running[:steps].tolist(), **named}


def load_evaluation(path: Path) -> Evaluation:
    """Reads the evaluation of a run directory, or an evaluation file itself.

    Raises:
        RunDirectoryError: If it is missing, not an evaluation, or holds what no reader could use;
            the message names the key.
    """
    file = path / EVALUATION if path.is_dir() else path
    if not file.is_file():
        raise RunDirectoryError(f"{file} does not exist; make it with: {again.evaluate(path)}")
    try:
        content = json.loads(file.read_text())
        if not isinstance(content, dict):
            raise TypeError("it is no object")
        # Files of before have no sum.
        if content.pop(SUM, written := _sum(content)) == written:
            return Evaluation.of(content)
    except (ValueError, TypeError, RecursionError) as error:
        raise RunDirectoryError(
            f"{file} is not an evaluation ({error}); make it again with: {again.evaluate(path)}"
        ) from error
    raise RunDirectoryError(
        f"{file} is not as it was written: damaged, or edited; make it again with: "
        f"{again.evaluate(path)}"
    )


def save_evaluation(path: Path, evaluation: Mapping[str, Any]) -> None:
    """Writes an evaluation, with a checksum for :func:`load_evaluation`."""
    plain = json.loads(as_json(evaluation))
    write_atomically(path, json.dumps(plain | {SUM: _sum(plain)}, indent=2) + "\n")


def _sum(evaluation: Mapping[str, Any]) -> str:
    content = {key: value for key, value in evaluation.items() if key != SUM}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def load_columns(path: Path) -> dict[str, list[Any]]:
    """Reads a table that :meth:`RunEvaluation.write` left; numbers come back as floats.

    Raises:
        RunDirectoryError: If it is missing or damaged.
    """
    if not path.is_file():
        raise RunDirectoryError(
            f"{path} does not exist; make it with: {again.evaluate(path.parent)}"
        )
    try:
        header, *rows = csv.reader(path.read_text().splitlines())
        return {
            name: [_value(name, cell) for cell in cells]
            for name, cells in zip(header, zip(*rows, strict=True), strict=True)
        }
    except ValueError as error:
        raise RunDirectoryError(
            f"{path} is damaged ({error}); make it again with: {again.evaluate(path.parent)}"
        ) from error


def _start_columns(task: Task, key: str, values: NDArray[Any]) -> dict[str, list[Any]]:
    named = {} if task.demos is None else {start.name: start.axes for start in task.demos.start}
    width = values.shape[1]
    axes = named.get(key) or [str(i) for i in range(width)]
    names = [f"{START}{key}.{axis}" for axis in axes] if width > 1 else [f"{START}{key}"]
    return {name: values[:, i].tolist() for i, name in enumerate(names)}


def _at(values: NDArray[Any], index: NDArray[Any]) -> NDArray[Any]:
    return np.take_along_axis(values, index, axis=1)[:, 0]


def _furthest(stages: Mapping[str, NDArray[np.bool_]]) -> list[str]:
    labels = np.array([NO_STAGE, *stages])
    reached = np.stack(list(stages.values()), axis=1)
    count = reached.shape[1]
    last = np.where(reached.any(axis=1), count - reached[:, ::-1].argmax(axis=1), 0)
    return [str(label) for label in labels[last]]


def _as_csv(columns: Columns) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*([_cell(v) for v in c] for c in columns.values()), strict=True))
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value)


def _value(column: str, cell: str) -> Any:
    if column in (STAGE, STRATEGY):
        return cell
    return float(cell) if cell else None
