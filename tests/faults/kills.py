"""Kills runs at random moments, lets them go on, and compares them with runs that were left alone.

    python -m tests.faults.kills --kills 200 --seed 0

Half of the kills come at any moment since the process began, half within the writing of a
checkpoint: at a file that is opened, renamed or removed there, and up to 3 ms later. A killed run
is started again and killed again, up to `CHAIN` times, and then goes on to its end. "Survived" is a
kill after which the next start went on without an error, "exact" one in a run whose weights,
learning curve, CSV and TensorBoard rows are, bit for bit, those of the run that nobody killed.
"""

from __future__ import annotations

import argparse
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tabulate import tabulate

from configs import compose
from pipeline.build import build_run
from pipeline.recipe import Recipe
from pipeline.train import run_command_line
from tests.faults.killing import (
    Ended,
    Work,
    compared,
    complete,
    half_written,
    in_a_child,
    planned,
)
from tests.toys import reach

CHAIN = 5
"""Kills of one run at most."""
TOY = f"task.name='{Path(reach.__file__)}'"
FEW = 8
"""Kills of subjects that take long."""
SMALL = (
    "preset=smoke", "torch_threads=1", "env.num_threads=1", "collector.total_frames=160",
    "collector.frames_per_batch=20", "bc.updates=100", "optim.actor_delay=0",
    "optim.updates_per_frame=0.2", "evaluation.interval=40", "logging.checkpoint_interval=39",
    "logging.interval=1", "logging.loggers=[csv,tensorboard]", "logging.progress=false",
)  # fmt: skip


@dataclass(frozen=True)
class Subject:
    """A kind of run.

    Attributes:
        name: in the table.
        work: what starts it, or goes on with it, below a folder.
        runs: its run directories below the folder.
        task: override that names the task again.
        exact: whether a run that goes on is the one that was left alone (an environment whose
            state cannot be saved begins its episodes anew).
        few: whether it takes long.
    """

    name: str
    work: Callable[[Path], Work]
    runs: tuple[str, ...] = ("run",)
    task: str = TOY
    exact: bool = True
    few: bool = False


@dataclass
class Tally:
    """What came of the kills of a subject."""

    injected: int = 0
    writing: int = 0
    survived: int = 0
    exact: int = 0
    wrong: list[str] = field(default_factory=list)


def trained(recipe: Recipe, run_dir: Path) -> None:
    """Starts the run or goes on with it, as a user who sees what is there."""
    if run_dir.exists() and not (run_dir / "config.yaml").exists():
        shutil.rmtree(run_dir)  # killed between making the directory and its first file
    build_run(recipe, run_dir, resume=run_dir.exists()).train()


def tortured(subject: Subject, kills: int, folder: Path, rng: Random) -> Tally:
    """Kills runs of ``subject`` until there were so many kills."""
    tally = Tally()
    whole = in_a_child(subject.work(folder / "whole"))
    if whole.code != 0:
        tally.wrong.append(f"{subject.name}: the run that was left alone ended with {whole.code}")
        return tally
    # What compilers and file systems keep is there now: the usual time is that of a second run.
    usual = in_a_child(subject.work(folder / "again"))
    shutil.rmtree(folder / "again")
    while tally.injected < kills:
        _chain(subject, min(CHAIN, kills - tally.injected), folder, usual, rng, tally)
        shutil.rmtree(folder / "killed", ignore_errors=True)
    return tally


def _chain(
    subject: Subject, kills: int, folder: Path, usual: Ended, rng: Random, tally: Tally
) -> None:
    killed = folder / "killed"
    injected = 0
    while injected < kills:
        before = half_written(killed)
        ended = in_a_child(subject.work(killed), planned(usual, rng))
        if ended.code is not None:
            break
        injected += 1
        tally.writing += bool(half_written(killed) - before)
    else:
        ended = in_a_child(subject.work(killed))
    tally.injected += injected
    if ended.code != 0:
        tally.survived += max(0, injected - 1)
        tally.wrong.append(f"{subject.name}: exit code {ended.code} after kill {tally.injected}")
        return
    tally.survived += injected
    compare = (lambda a, b: compared(a, b, subject.task)) if subject.exact else complete
    found = [
        f"{name}: {what}"
        for name in subject.runs
        for what in compare(killed / name, folder / "whole" / name)
    ]
    if found:
        tally.wrong.append(f"{subject.name}: after kill {tally.injected}: {', '.join(found)}")
    elif subject.exact:
        tally.exact += injected


def subject_of(
    variant: str, demos: Path, *overrides: str, name: str = "", **about: object
) -> Subject:
    """Runs of a variant, each with a cache of its own below its folder."""

    def work(folder: Path) -> Work:
        recipe = compose(
            f"variant={variant}", *SMALL, f"cache_dir='{folder / 'cache'}'",
            *([TOY, f"demos.source='{demos}'"] if "task" not in about else [about["task"]]),
            *overrides,
        )  # fmt: skip
        return lambda: trained(recipe, folder / "run")

    return Subject(name or variant, work, **about)


def sweep_of(demos: Path) -> Subject:
    """Two runs by one command; what is there of them when it is killed goes on one by one."""
    seeds = ("0", "1")

    def typed(folder: Path) -> list[str]:
        return [*SMALL, TOY, f"demos.source='{demos}'", f"cache_dir='{folder / 'cache'}'"]

    def work(folder: Path) -> Work:
        recipes = {
            seed: compose("variant=sid_bc", *typed(folder), f"seed={seed}") for seed in seeds
        }

        def swept() -> None:
            if not any((folder / seed).exists() for seed in seeds):
                folder.mkdir(parents=True, exist_ok=True)
                sys.argv[1:] = [
                    "--multirun", "variant=sid_bc", *typed(folder), f"seed={','.join(seeds)}",
                    f"run_dir='{folder}/${{seed}}'", f"hydra.sweep.dir='{folder / 'hydra'}'",
                ]  # fmt: skip
                run_command_line()
            else:
                for seed, recipe in recipes.items():
                    trained(recipe, folder / seed)

        return swept

    return Subject("sweep of two runs", work, runs=seeds, few=True)


def subjects(folder: Path) -> Iterator[Subject]:
    """All variants on the toy, two environments of gymnasium's, compiled updates, a sweep."""
    demos = folder / "reach.h5"
    reach.record(demos)
    for path in sorted(Path("configs/variant").glob("*.yaml")):
        yield subject_of(path.stem, demos)
    mujoco, python = ("gymnasium:InvertedPendulum-v5", "gymnasium:Pendulum-v1")
    yield subject_of("sac", demos, name=f"sac, {mujoco}", task=f"task.name='{mujoco}'")
    yield subject_of("sac", demos, name=f"sac, {python}", task=f"task.name='{python}'", exact=False)
    yield sweep_of(demos)
    yield subject_of("sac", demos, "compile_updates=true", name="sac, compiled", few=True)


def table(tallies: dict[str, Tally], inexact: set[str]) -> str:
    """In Markdown."""
    rows: list[list[object]] = [
        [name, t.injected, t.writing, t.survived, "-" if name in inexact else t.exact, len(t.wrong)]
        for name, t in tallies.items()
    ]
    counted = ("injected", "writing", "survived", "exact")
    sums = [sum(getattr(t, name) for t in tallies.values()) for name in counted]
    rows.append(["all", *sums, sum(len(t.wrong) for t in tallies.values())])
    headers = ["killed", "injected", "in a write", "survived", "exact", "wrong"]
    return tabulate(rows, headers=headers, tablefmt="github")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200, help="of all subjects together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="subjects whose name holds this")
    arguments = parser.parse_args()
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    os.environ["TORCHINDUCTOR_COMPILE_THREADS"] = "1"  # processes of its own would outlive a kill
    tallies: dict[str, Tally] = {}
    inexact = set()
    with tempfile.TemporaryDirectory() as given:
        chosen = [s for s in subjects(Path(given)) if arguments.only in s.name]
        each = {s.name: FEW for s in chosen if s.few}
        usual = [s for s in chosen if not s.few]
        for i, subject in enumerate(usual):
            left = max(0, arguments.kills - sum(each.values()))
            each[subject.name] = -(-left // (len(usual) - i))
        for subject in chosen:
            rng = Random(f"{arguments.seed} {subject.name}")
            folder = Path(given) / "subject"
            tallies[subject.name] = tortured(subject, each[subject.name], folder, rng)
            shutil.rmtree(folder, ignore_errors=True)
            if not subject.exact:
                inexact.add(subject.name)
            print(f"{subject.name}: {tallies[subject.name]}", file=sys.stderr, flush=True)
    print(table(tallies, inexact))
    sys.exit("\n".join(wrong for tally in tallies.values() for wrong in tally.wrong) or 0)


if __name__ == "__main__":
    main()
