"""``make results`` of several tasks: evaluated runs in, a file of all cells and policies out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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


def publish_cells(cells: Sequence[Cell], out: Path) -> list[Cell]:
    """Adds cells to those that are published; a seed that is there is replaced.

    Args:
        cells: Of the runs.
        out: Folder of the results; the file is ``tasks/cells.parquet`` in it.

    Returns:
        All cells of the file.

    Raises:
        RunDirectoryError: See :func:`~pipeline.results.cells.merge_cells`; nothing is written then.
    """
    path = out / FOLDER / FILE
    merged = merge_cells(load_cells(path), cells)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_cells(merged, path)
    return merged


def publish_policies(cells: Sequence[Cell], published: Sequence[Cell], out: Path) -> None:
    """Writes a policy of each task, reward and row that ``cells`` are of.

    Args:
        cells: Of the runs.
        published: All cells of the file, among whose seeds the middle one is sought.
        out: Folder of the results; a policy is ``policies/TASK_REWARD/ROW`` in it.
    """
    changed = {(cell.task, cell.reward, cell.row) for cell in cells}
    for (task, reward, row), found in by_place(published).items():
        if (task, reward, row) in changed:
            export_middle(as_row(found), out / POLICIES, f"{task}_{reward}", row)


def read_cells(folders: Sequence[Path], out: Path, *, unclean: bool = False) -> list[Cell]:
    """The cells of all runs in these folders.

    Raises:
        RunDirectoryError: If one of them cannot be published, which is named with the remedy.
    """
    listed = read_listed(out / FOLDER / LISTED)
    return [read_cell(run, listed, unclean=unclean) for run in find_runs(folders)]
