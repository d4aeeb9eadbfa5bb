"""The table over tasks: a cell for each task, reward and row, several seeds, in one file.

The rows of the door that ``make results`` publishes stand in files of their own; a cell of every
other task, or of another reward, is a line of ``cells.parquet`` for each seed, written by
:func:`pipeline.results.publish_cells.publish_cells`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pipeline.files.run_files import RunDirectoryError
from pipeline.results import columnar
from pipeline.results.reading import parse_published
from pipeline.results.rows import recipe_difference
from pipeline.results.runs import EvaluatedRun, RunGroup

FILE: Final = "cells.parquet"
FOLDER: Final = "tasks"
"""Of the file, below that of the results."""
KEYS: Final = ("task", "reward", "row", "seed")
OWN: Final = "own"
"""Reward of a task that offers one only."""
CONDITIONS: Final = (
    "preset", "frames", "updates", "simulator_steps", "wall_s", "demonstrations",
    "demonstrations_by", "demonstrations_multiplied", "torch_threads", "env_threads", "git",
    "trained_with",
)  # fmt: skip
"""What a line says of a run beside its evaluation, see :class:`Cell`."""


@dataclass(frozen=True)
class Cell:
    """One run of the table.

    Attributes:
        task: name, without the folders of a file.
        reward: one of the task's rewards; ``own`` where it offers only one.
        row: variant, and its imitation weight where there are rows of several.
        conditions: by the names of ``CONDITIONS``: preset; frames of training; updates;
            simulator steps in all (evaluations apart; None where nobody counted); wall time (s);
            how many demonstrations there were and who made them (``human``, ``robot``; None where
            it is not told) and whether they were multiplied; threads of torch and of the physics;
            revision and versions of the training.
        run: evaluation, learning curve and alarms.
    """

    task: str
    reward: str
    row: str
    conditions: Mapping[str, Any]
    run: EvaluatedRun

    @property
    def keys(self) -> columnar.Keys:
        """What names it."""
        return (self.task, self.reward, self.row, self.run.seed)


Place = tuple[str, str, str]
"""Task, reward and row."""


def save_cells(cells: Sequence[Cell], path: Path) -> None:
    """Writes the file anew; its numbers are figures, so no place on this machine is in it."""
    runs = {
        cell.keys: {**cell.conditions, **without_places(cell.run.published())} for cell in cells
    }
    columnar.save(KEYS, runs, path)


def load_cells(path: Path) -> list[Cell]:
    """What :func:`save_cells` wrote; nothing where there is no such file.

    Raises:
        RunDirectoryError: If it is damaged.
    """
    if not path.is_file():
        return []
    cells = []
    for (task, reward, row, _), content in columnar.load(KEYS, path).items():
        try:
            conditions = {name: content.pop(name) for name in CONDITIONS}
        except KeyError as error:
            raise RunDirectoryError(
                f"{path} has no column {error}; remove it and publish again: make results"
            ) from error
        cells.append(Cell(task, reward, row, conditions, parse_published(path, content)))
    return cells


def by_place(cells: Sequence[Cell]) -> dict[Place, list[Cell]]:
    """Cells of one task, reward and row together, by seed."""
    found: dict[Place, list[Cell]] = {}
    for cell in sorted(cells, key=lambda cell: cell.keys):
        found.setdefault((cell.task, cell.reward, cell.row), []).append(cell)
    return found


def as_row(cells: Sequence[Cell]) -> RunGroup:
    """Cells of one place as a row of results, in the order of their seeds."""
    runs = sorted((cell.run for cell in cells), key=lambda run: run.seed)
    return RunGroup(cells[0].row, tuple(runs))


def merge_cells(earlier: Sequence[Cell], later: Sequence[Cell]) -> list[Cell]:
    """All of both; where both have a seed of a row, the later one counts.

    Raises:
        RunDirectoryError: If two of ``later`` are the same cell, or if a row that gains seeds
            would hold those of different recipes.
    """
    added: dict[columnar.Keys, Cell] = {}
    for cell in later:
        if (other := added.setdefault(cell.keys, cell)) is not cell:
            task, reward, row, seed = cell.keys
            raise RunDirectoryError(
                f"{other.run.path} and {cell.run.path} are both seed {seed} of row {row} of "
                f'{task}, {reward}: name folders that hold one of them (RUNS="dir dir ...")'
            )
    merged = {**{cell.keys: cell for cell in earlier}, **added}
    gained = {(cell.task, cell.reward, cell.row) for cell in later}
    for place, cells in by_place(list(merged.values())).items():
        if place in gained:
            _require_one_recipe(place, cells)
    return [merged[keys] for keys in sorted(merged)]


def _require_one_recipe(place: Place, cells: Sequence[Cell]) -> None:
    difference = recipe_difference(as_row(cells))
    if difference is not None:
        raise RunDirectoryError(
            f"{place[0]}, {place[1]}: {difference}; publish all its seeds of one recipe together, "
            "or to another folder (OUT=...)"
        )


def without_places(value: Any) -> Any:
    """A published value whose absolute paths are names alone: others have other folders."""
    if isinstance(value, Mapping):
        return {key: without_places(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_places(entry) for entry in value]
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value
