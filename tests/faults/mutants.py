"""Reads damaged copies of every kind of file that comes from others, and counts what comes of it.

    python -m tests.faults.mutants --files 1000 --seed 0

The formats of demonstrations, and the texts of a run directory without their checksums, which
would refuse most of it. "Read" is damage that nobody can see (a number became another) or that is
dropped with a warning, "refused" is one line that names the file; anything else is wrong: another
exception, several lines, more than `SECONDS`, or a process that dies.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from envs.demonstrations import DemonstrationError, open_source
from pipeline.files.curves import read_lines
from pipeline.files.run_files import CONFIG, EVALUATION, LEARNING_CURVE, RunDirectoryError
from pipeline.files.run_format import RunFormatError
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import load_columns, load_evaluation, save_evaluation
from pipeline.run_dir import load_recipe, save_recipe
from tests.envs.demonstrations.files_of_others import ROBOMIMIC_SCHEMA, SCHEMA
from tests.envs.demonstrations.test_mutations import WRITERS, damaged

SECONDS = 60.0
REFUSALS = (DemonstrationError, RunDirectoryError, RunFormatError)
OUTCOMES = ("read", "refused", "wrong")


@dataclass(frozen=True)
class Reader:
    """A whole file or folder, and what reads its copies."""

    name: str
    whole: Path
    read: Callable[[Path], Any]


def readers_of_demonstrations(folder: Path) -> list[Reader]:
    """One for each format."""
    found = []
    for name, write in WRITERS.items():
        place = folder / name
        place.mkdir()
        os.environ["MINARI_DATASETS_PATH"] = str(place)
        written = write(place / "whole")
        schema = ROBOMIMIC_SCHEMA if name == "robomimic" else SCHEMA
        whole = written if written is not None else place / "whole.h5"
        found.append(Reader(name, whole, lambda p, schema=schema: open_source(p).load(schema)))
    return found


def readers_of_texts(folder: Path) -> list[Reader]:
    """Of a run directory: each text in a folder of its own, as its reader expects it."""
    run = folder / "run"
    run.mkdir()
    save_recipe(run, Recipe(seed=3))
    config = run / CONFIG
    config.write_text(config.read_text().partition("\n")[2])
    evaluation = run / EVALUATION
    made_from = {"run": "runs/x", "variant": "bc", "seed": 3}
    figures = {"episodes": 10, "return_mean": 12.25, "stages": {"open": 0.1}}
    save_evaluation(evaluation, figures | {"made_from": made_from})
    plain = json.loads(evaluation.read_text())
    evaluation.write_text(json.dumps({key: plain[key] for key in list(plain)[:4]}, indent=2))
    (curve := run / LEARNING_CURVE).write_text(
        "".join(json.dumps({"frames": i, "return_mean": i / 3}) + "\n" for i in range(9))
    )
    (columns := run / "episodes.csv").write_text("return,success\n1.5,1\n2.5,0\n")
    return [
        Reader(CONFIG, config, lambda path: load_recipe(path.parent)),
        Reader(EVALUATION, evaluation, load_evaluation),
        Reader(LEARNING_CURVE, curve, read_lines),
        Reader("episodes.csv", columns, load_columns),
    ]


def outcome(reader: Reader, copy: Path) -> str:
    """What comes of reading a damaged copy."""
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(copy)
        came = "read"
    except REFUSALS as error:
        one_line = "\n" not in str(error) and copy.name in str(error)
        came = "refused" if one_line else f"wrong: {error!r}"
    except Exception as error:
        came = f"wrong: {error!r}"
    took = time.process_time() - began
    return came if took < SECONDS else f"wrong: took {took:.0f} s"


def mutated(reader: Reader, folder: Path, rng: np.random.Generator) -> Path:
    """A copy with one of its files damaged."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    copy = folder / reader.whole.name
    (shutil.copytree if reader.whole.is_dir() else shutil.copy)(reader.whole, copy)
    files = sorted(f for f in copy.rglob("*") if f.is_file()) if copy.is_dir() else [copy]
    file = files[rng.integers(len(files))]
    file.write_bytes(damaged(file.read_bytes(), rng))
    return copy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000, help="of all readers together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="readers whose name holds this")
    given = parser.parse_args()
    logging.disable(logging.WARNING)  # of every line that is left out
    rows, wrong = [], []
    with tempfile.TemporaryDirectory() as folder:
        found = [*readers_of_texts(Path(folder)), *readers_of_demonstrations(Path(folder))]
        chosen = [reader for reader in found if given.only in reader.name]
        for reader in chosen:
            rng = np.random.default_rng([given.seed, *reader.name.encode()])
            reader.read(reader.whole)
            tally: Counter[str] = Counter()
            for number in range(-(-given.files // len(chosen))):
                came = outcome(reader, mutated(reader, Path(folder) / "copy", rng))
                tally[came.split(":")[0]] += 1
                if came.startswith("wrong"):
                    wrong.append(f"{reader.name}, copy {number}: {came}")
            rows.append([reader.name, tally.total(), *(tally[one] for one in OUTCOMES)])
            print(*rows[-1], file=sys.stderr, flush=True)
    rows.append(["all", *(sum(row[i] for row in rows) for i in range(1, 5))])
    print(tabulate(rows, headers=["format", "tried", *OUTCOMES], tablefmt="github"))
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
