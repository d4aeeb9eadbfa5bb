"""``make results`` of several tasks: evaluated runs in, a file of all cells and policies out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from envs.whole_files import whole_set
from pipeline.results.cells import (
    FILE,
    FOLDER,
    Cell,
    as_row,
    by_place,
    load_cells,
    merge_cells,
    save_cells,
)
from pipeline.results.demonstrators import FILE as LISTED
from pipeline.results.demonstrators import read_listed
from pipeline.results.export import POLICIES, export_middle
from pipeline.results.run_cells import find_runs, read_cell
from pipeline.results.runs import RunGroup


def publish_cells(cells: Sequence[Cell], out: Path, *, policies: bool = True) -> list[Cell]:
    """Adds cells to those that are published; a seed that is there is replaced.

    Args:
        cells: Of the runs.
        out: Folder of the results; the file is ``tasks/cells.parquet`` in it, a policy of each
            task, reward and row that ``cells`` are of is ``policies/TASK_REWARD/ROW``.
        policies: Whether policies are written.

    Returns:
        All cells of the file.

    Raises:
        RunDirectoryError: See :func:`~pipeline.results.cells.merge_cells`; nothing is written then.
        FileNotFoundError, ValueError: If the weights of a policy are missing or damaged; likewise.
    """
    merged = merge_cells(load_cells(out / FOLDER / FILE), cells)
    with whole_set(out) as made:
        for place in {(cell.task, cell.reward, cell.row) for cell in cells if policies}:
            _export(as_row(by_place(merged)[place]), place, out, made)
        (made / FOLDER).mkdir()
        save_cells(merged, made / FOLDER / FILE)
    return merged


def _export(row: RunGroup, place: tuple[str, str, str], out: Path, made: Path) -> None:
    """The policy of the seed in the middle of all that are published."""
    task, reward, name = place
    export_middle(row, out / POLICIES, f"{task}_{reward}", name, made=made / POLICIES)


def read_cells(folders: Sequence[Path], out: Path, *, unclean: bool = False) -> list[Cell]:
    """The cells of all runs in these folders.

    Raises:
        RunDirectoryError: If one of them cannot be published, which is named with the remedy.
    """
    listed = read_listed(out / FOLDER / LISTED)
    return [read_cell(run, listed, unclean=unclean) for run in find_runs(folders)]
