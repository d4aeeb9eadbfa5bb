"""Rows over frames in files: read whatever they hold, and cut back to where a run goes on."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeGuard

from envs.whole_files import whole_file
from pipeline.files.run_files import ALARMS, LEARNING_CURVE, write_atomically

_logger = logging.getLogger(__name__)

Row = dict[str, Any]
FRAMES = "frames"
WALL_S = "wall_s"
LOGS = "logs"
"""Of the loggers, in the run directory."""


def read_lines(path: Path) -> list[Row]:
    """Rows of a JSON-lines file of a run, in order of frames; none if there is no such file.

    A line that is no row, such as the half-written last one of a run that was killed, or one with a
    number that is too large for a float, is left out with a warning.
    """
    if not path.is_file():
        return []
    return in_order(row for _, row in _parsed(path))


def count_no_rows(path: Path) -> int:
    """Lines of a file that :func:`read_lines` leaves out; 0 if there is no such file."""
    return sum(row is None for _, row in _lines(path)) if path.is_file() else 0


def in_order(rows: Iterable[Mapping[str, Any]]) -> list[Row]:
    """Rows by their frames, smallest first; of several at the same frame the last one counts."""
    by_frames = {float(row[FRAMES]): dict(row) for row in rows if is_number(row.get(FRAMES))}
    return [by_frames[frames] for frames in sorted(by_frames)]


def last_wall_s(run_dir: Path) -> float:
    """Wall time of the learning curve's last row, in seconds; 0 where there is none."""
    walls = [row.get(WALL_S) for row in read_lines(run_dir / LEARNING_CURVE)]
    return max((float(wall) for wall in walls if is_number(wall)), default=0.0)


def cut_back(run_dir: Path, frames: int) -> None:
    """Drops what was written after ``frames``: a run that goes on from there writes it again.

    That is rows of the learning curve, alarms, and lines of the CSV and TensorBoard loggers. Files
    in which there is nothing to drop stay as they are.
    """
    for name in (LEARNING_CURVE, ALARMS):
        path = run_dir / name
        if path.is_file():
            lines = [line for line, row in _parsed(path) if float(row[FRAMES]) <= frames]
            _replace(path, lines)
    for path in sorted((run_dir / LOGS).glob("csv/scalars/**/*.csv")):
        _replace(path, [line for line in _whole_lines(path) if _step(line) <= frames])
    for path in sorted((run_dir / LOGS).glob("tensorboard/**/events.out.tfevents.*")):
        _cut_events(path, lambda step: step <= frames)


def _parsed(path: Path) -> Iterable[tuple[str, Row]]:
    for number, (line, row) in enumerate(_lines(path), 1):
        if row is not None:
            yield line, row
        else:
            _logger.warning("%s: line %d is no row (%.40r): it is left out", path, number, line)


def _lines(path: Path) -> Iterable[tuple[str, Row | None]]:
    for line in path.read_text(errors="replace").splitlines():
        try:
            row = json.loads(line, parse_int=_integer)
        except (ValueError, OverflowError, RecursionError):
            row = None
        yield line, row if isinstance(row, dict) and is_number(row.get(FRAMES)) else None


def _integer(digits: str) -> int:
    """An integer that whoever reads the row can make a float of."""
    number = int(digits)
    float(number)
    return number


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value of a row is a finite number."""
    return isinstance(value, (int, float)) and math.isfinite(value)


def _whole_lines(path: Path) -> list[str]:
    *whole, _rest = path.read_text().split("\n")
    return whole


def _step(line: str) -> float:
    try:
        return float(line.split(",")[0])
    except ValueError:
        return float("inf")


def _replace(path: Path, lines: list[str]) -> None:
    text = "".join(f"{line}\n" for line in lines)
    if path.read_text(errors="replace") != text:
        write_atomically(path, text)


def _cut_events(path: Path, kept: Callable[[int], bool]) -> None:
    """Rewrites a file of TensorBoard's without the scalars of steps that are not ``kept``."""
    # Only a run that logs there needs them.
    from tensorboard.backend.event_processing.event_file_loader import (  # noqa: PLC0415
        RawEventFileLoader,
    )
    from tensorboard.compat.proto.event_pb2 import Event  # noqa: PLC0415
    from tensorboard.summary.writer.record_writer import RecordWriter  # noqa: PLC0415

    records = list(RawEventFileLoader(str(path)).Load())
    events = [Event.FromString(record) for record in records]
    stays = [not event.HasField("summary") or kept(event.step) for event in events]
    if all(stays):
        return
    with whole_file(path) as temporary, temporary.open("wb") as file:
        writer = RecordWriter(file)
        for record, stay in zip(records, stays, strict=True):
            if stay:
                writer.write(record)
        writer.flush()
