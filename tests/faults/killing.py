"""Processes that are killed at chosen moments, and runs that are compared afterwards."""

from __future__ import annotations

import os
import random
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import NoReturn

import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from pipeline.files.checkpoint import latest_checkpoint
from pipeline.files.run_files import CHECKPOINTS
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from tests.pipeline.resuming import curve_of, differences

LATER_S = 0.003
FILE_EVENTS = {"open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "shutil.rmtree"}

Work = Callable[[], None]


@dataclass(frozen=True)
class Ended:
    """How a process did.

    Attributes:
        code: its exit code, None if it was killed.
        events: what it did to files of checkpoints.
        seconds: how long it lived.
    """

    code: int | None
    events: int
    seconds: float


@dataclass(frozen=True)
class Kill:
    """When: so many seconds after the start, or after so many events in checkpoints."""

    after_s: float | None = None
    after_events: int | None = None
    later_s: float = 0.0


def planned(whole: Ended, rng: Random) -> Kill:
    """A random moment of what ``whole`` did: every second one within a checkpoint's writing."""
    if rng.random() < 0.5 and whole.events:
        after = rng.randrange(whole.events) + 1
        return Kill(after_events=after, later_s=rng.uniform(0.0, LATER_S))
    return Kill(after_s=rng.uniform(0.0, whole.seconds))


def in_a_child(work: Work, kill: Kill | None = None) -> Ended:
    """Does ``work`` in a process of its own, which is killed if it lives that long."""
    reader, writer = os.pipe()
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _as_a_child(work, writer)
    os.close(writer)
    events = _watched(reader, kill, began)
    if kill is not None:
        time.sleep(kill.later_s)
        os.kill(child, signal.SIGKILL)
    os.close(reader)
    _, status = os.waitpid(child, 0)
    code = None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
    return Ended(code, events, time.monotonic() - began)


def _as_a_child(work: Work, writer: int) -> NoReturn:
    code = 1
    try:
        sys.addaudithook(lambda event, given: _reported(event, given, writer))
        torch.set_num_threads(1)
        torch.manual_seed(random.randrange(2**31))  # whatever was before must not matter
        work()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _reported(event: str, given: tuple[object, ...], writer: int) -> None:
    if event in FILE_EVENTS and given and f"/{CHECKPOINTS}/" in str(given[0]):
        os.write(writer, b".")


def _watched(reader: int, kill: Kill | None, began: float) -> int:
    """Waits for the moment of ``kill`` or the child's end; returns how many events there were."""
    events = 0
    while True:
        left = None
        if kill is not None and kill.after_s is not None:
            left = max(0.0, kill.after_s - (time.monotonic() - began))
        if not select.select([reader], [], [], left)[0]:
            return events
        read = os.read(reader, 1)
        events += len(read)
        if not read or (kill is not None and events == kill.after_events):
            return events


def half_written(folder: Path) -> set[Path]:
    """What is there of checkpoints that were being written when a run below ``folder`` died."""
    return set(folder.glob(f"**/{CHECKPOINTS}/.*"))


def events_of(run_dir: Path) -> dict[str, list[tuple[int, str]]]:
    """Scalars of TensorBoard by name, without the time, which is another one each time.

    In order of steps: of two files that begin within one second, it reads that of the smaller
    process number first.
    """
    events = EventAccumulator(str(run_dir / "logs/tensorboard"), purge_orphaned_data=False)
    events.Reload()
    return {
        tag: sorted((event.step, str(event.value)) for event in events.Scalars(tag))
        for tag in events.Tags()["scalars"]
        if not tag.endswith("wall_s")
    }


def compared(run_dir: Path, whole: Path, task: str) -> list[str]:
    """In what the two runs differ; ``task`` is an override that names their task again."""
    weights = []
    for folder in (whole, run_dir):
        saved = load_recipe(folder, [task])
        weights.append(load_policy(saved, saved.task.find(), folder)[0].state_dict())
    found = [f"weight {name}" for name in differences(*weights)]
    if curve_of(run_dir) != curve_of(whole):
        found.append("learning curve")
    if events_of(run_dir) != events_of(whole):
        found.append("TensorBoard")
    for path in sorted((whole / "logs/csv").rglob("*.csv")):
        ours = run_dir / path.relative_to(whole)
        if path.stem != "wall_s" and (not ours.exists() or ours.read_text() != path.read_text()):
            found.append(path.name)
    return found


def complete(run_dir: Path, whole: Path) -> list[str]:
    """What is missing or there twice of a run that cannot be the same as ``whole``."""
    ours, theirs = ([row["frames"] for row in curve_of(folder)] for folder in (run_dir, whole))
    found = [] if ours == theirs else [f"rows at {ours}, not at {theirs}"]
    if latest_checkpoint(run_dir).name != latest_checkpoint(whole).name:
        found.append(f"ends with {latest_checkpoint(run_dir).name}")
    return found
