"""Finds runs and reads what is left of each, directories and published files alike.

:func:`read_run` notes what cannot be read and leaves it out; :func:`load_run` is for those who need
the evaluation.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml

from envs.one_line import text_of
from pipeline.dotted import flatten
from pipeline.files import again
from pipeline.files.curves import count_no_rows, in_order, read_lines
from pipeline.files.run_files import (
    ALARMS,
    CHECKPOINTS,
    CONFIG,
    EVALUATION,
    LEARNING_CURVE,
    PLACES,
    VERSIONS,
    RunDirectoryError,
)
from pipeline.files.time_use import TIME_USE
from pipeline.renamed import rename_keys
from pipeline.results.evaluation import Evaluation, Versions
from pipeline.results.evaluation_files import (
    EPISODES,
    PROGRESS_CURVE,
    Columns,
    beside,
    load_columns,
    load_evaluation,
)
from pipeline.results.robustness import ROBUSTNESS, Robustness
from pipeline.results.runs import EvaluatedRun

Read = TypeVar("Read")
SEED: Final = "seed"
ROWS: Final = "rows"
"""Folder of the published files, ``ROW/seedN.json``."""
BROKEN = (
    OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, yaml.YAMLError
)  # fmt: skip
"""What reading a broken file raises."""
Json = Mapping[str, Any]


def read_runs(paths: Sequence[Path]) -> list[EvaluatedRun]:
    """Reads every run that the paths lead to, each once.

    A path is a run directory, a published file ``seedN.json`` or another evaluation, or a folder of
    any of these: ``ROW/``, ``rows/`` with ``ROW/seedN`` below it, ``docs/results``.

    Raises:
        RunDirectoryError: If a path leads to none.
    """
    found: dict[Path, EvaluatedRun] = {}
    for path in paths:
        runs = list(_runs_at(path, depth=2))
        if not runs:
            raise RunDirectoryError(
                f"{path} is no run: name run directories, evaluation files, or folders of them "
                "(runs/rows, docs/results/rows/best, docs/results)"
            )
        found |= {run.resolve(): read_run(run) for run in runs if run.resolve() not in found}
    return list(found.values())


def read_run(path: Path) -> EvaluatedRun:
    """Reads a run directory or an evaluation file; never fails, see ``EvaluatedRun.missing``."""
    return _of_directory(path) if path.is_dir() else _of_file(path)


def load_run(path: Path) -> EvaluatedRun:
    """Reads an evaluated run, likewise.

    Raises:
        RunDirectoryError: If it has no evaluation that can be read.
    """
    run = read_run(path)
    if run.evaluation_or_none is None:
        raise RunDirectoryError(run.missing[0])
    return run


def parse_published(path: Path, content: Mapping[str, Any]) -> EvaluatedRun:
    """The run of which a published file tells.

    Args:
        path: Of the file.
        content: That it holds of the run.

    Raises:
        RunDirectoryError: If it is damaged.
    """
    try:
        evaluation = dict(content)
        curve, alarms = evaluation.pop("curve"), evaluation.pop("alarms")
        points = zip(*curve.values(), strict=True)
        rows = in_order(dict(zip(curve, point, strict=True)) for point in points)
        return EvaluatedRun(path, Evaluation.of(evaluation), tuple(rows), tuple(alarms))
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise RunDirectoryError(
            f"{path} is not a published run ({error}); restore or remove it"
        ) from error


def _runs_at(path: Path, depth: int) -> Iterator[Path]:
    if path.is_file() or _is_run(path):
        yield path
        return
    if not path.is_dir():
        return
    below = path / ROWS if (path / ROWS).is_dir() else path
    for entry in sorted(below.iterdir(), key=_by_number):
        if _is_run(entry) or (entry.is_file() and entry.match(f"{SEED}*.json")):
            yield entry
        elif entry.is_dir() and depth > 1:
            yield from _runs_at(entry, depth - 1)


def _is_run(path: Path) -> bool:
    return any((path / name).is_file() for name in (CONFIG, EVALUATION, LEARNING_CURVE))


def _by_number(path: Path) -> tuple[str, int, str]:
    number = path.stem.removeprefix(SEED)
    return (SEED, int(number), "") if number.isdigit() else (path.name, 0, "")


def _folder(path: Path) -> str | None:
    in_a_row = path.stem.startswith(SEED) and path.stem.removeprefix(SEED).isdigit()
    return path.parent.name if in_a_row else None


class _Reader:
    """Reads files one by one and keeps what went wrong."""

    def __init__(self) -> None:
        self.missing: list[str] = []

    def __call__(self, read: Callable[[], Read], otherwise: Read) -> Read:
        try:
            return read()
        except BROKEN as error:
            self.missing.append(text_of(error))
            return otherwise


def _of_directory(path: Path) -> EvaluatedRun:
    reader = _Reader()
    evaluation = reader(lambda: load_evaluation(path), None)
    nothing: list[dict[str, Any]] = []
    curve = reader(lambda: read_lines(path / LEARNING_CURVE), nothing)
    if not curve and not (path / LEARNING_CURVE).is_file():
        reader.missing.append(f"{path / LEARNING_CURVE}: no learning curve")
    for file in (path / LEARNING_CURVE, path / ALARMS):
        if lost := count_no_rows(file):
            reader.missing.append(f"{file} is damaged: lines that are no row are left out: {lost}")
    episodes, progress = _tables(reader, path / EVALUATION, evaluation)
    reader.missing.extend(_outdated(path, evaluation))
    return EvaluatedRun(
        path=path,
        folder=_folder(path),
        evaluation_or_none=evaluation,
        curve=curve,
        alarms=reader(lambda: read_lines(path / ALARMS), []),
        episodes=episodes,
        progress=progress,
        settings=reader(lambda: flatten(_yaml(path / CONFIG)), {}),
        seconds=reader(lambda: _object(path / TIME_USE).get("parts_s", {}), {}),
        versions=reader(lambda: Versions.of(_object(path / VERSIONS)), Versions()),
        robustness=reader(lambda: _robustness(path / ROBUSTNESS), None),
        missing=tuple(reader.missing),
    )


def _of_file(path: Path) -> EvaluatedRun:
    reader = _Reader()
    evaluation = reader(lambda: load_evaluation(path), None)
    if evaluation is not None and "curve" in evaluation.content:
        run = reader(lambda: parse_published(path, evaluation.content), None)
        if run is not None:
            return replace(run, folder=_folder(path))
        return EvaluatedRun(path, folder=_folder(path), missing=tuple(reader.missing))
    episodes, progress = _tables(reader, path, evaluation)
    return EvaluatedRun(
        path=path,
        folder=_folder(path),
        evaluation_or_none=evaluation,
        episodes=episodes,
        progress=progress,
        missing=tuple(reader.missing),
    )


def _tables(reader: _Reader, path: Path, evaluation: Evaluation | None) -> tuple[Columns, Columns]:
    """The tables beside an evaluation, if they are of it."""
    nothing: tuple[Columns, Columns] = ({}, {})
    if evaluation is None:
        return nothing
    episodes: Columns = reader(lambda: load_columns(beside(path, EPISODES)), {})
    if episodes and len(episodes["episode"]) != evaluation.episodes:
        reader.missing.append(
            f"{beside(path, EPISODES)} holds {len(episodes['episode'])} episodes and {path.name} "
            f"{evaluation.episodes}: they are of two evaluations; make them again: "
            f"{again.evaluate(path)}"
        )
        return nothing
    curve = beside(path, PROGRESS_CURVE)
    progress: Columns = reader(lambda: load_columns(curve), {}) if curve.is_file() else {}
    return episodes, progress


def _outdated(path: Path, evaluation: Evaluation | None) -> list[str]:
    """Whether the run has gone on since it was evaluated."""
    judged = "" if evaluation is None else str(evaluation.made_from.checkpoint)
    newest = max((found.name for found in (path / CHECKPOINTS).glob("checkpoint-*")), default="")
    if not judged.startswith("checkpoint-") or newest <= judged:
        return []
    return [
        f"{path / EVALUATION} is of {judged}, and the run has gone on to {newest}: evaluate it "
        f"again with: {again.evaluate(path)}"
    ]


def _robustness(path: Path) -> Robustness | None:
    return Robustness.read(path) if path.is_file() else None


def _yaml(path: Path) -> Json:
    content = yaml.safe_load(path.read_text()) if path.is_file() else {}
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no recipe")
    return rename_keys({key: value for key, value in content.items() if key not in PLACES})


def _object(path: Path) -> Json:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged ({error})") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no object")
    return content
