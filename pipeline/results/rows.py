"""Runs of one row of the tables, one per seed: run directories, and the files published of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.files.curves import in_order, read_lines
from pipeline.files.run_files import ALARMS, EVALUATION, LEARNING_CURVE, RunDirectoryError
from pipeline.results.evaluation import Evaluation
from pipeline.results.evaluation_files import load_evaluation

SEED = "seed"
ROWS = "rows"
"""Folder of the published files, ``ROW/seedN.json``."""
RECIPE = (
    "variant",
    "preset",
    "bc_weight",
    "frames",
    "demos",
    "demos_multiplied",
    "evaluation_seed",
    "exploration",
    "noise_scale",
)
"""What the seeds of one row have in common."""
ORDER = (
    "sac", "bc", "bc_sac_0.1", "bc_sac_1", "bc_sac_10", "dbc_sac", "sid_bc", "sid_dbc",
    "ila_bc", "ila_dbc", "da_sac", "best",
)  # fmt: skip
"""Of the paper's tables, then our own."""
BEFORE_IT_WAS_NAMED = {"noise_scale": 1.0}
"""What held for evaluations that are older than a key of ``RECIPE``."""
DIGITS = 6
"""Significant digits of published curves."""


@dataclass(frozen=True)
class Seed:
    """One evaluated run."""

    evaluation: Evaluation
    curve: tuple[Mapping[str, Any], ...]
    """Rows of the learning curve; empty for a run without a curve."""
    alarms: tuple[Mapping[str, Any], ...]
    run_dir: Path | None = None
    """None where only the published file is left of the run."""

    @property
    def seed(self) -> int:
        """Of the run."""
        return self.evaluation.made_from.seed

    def published(self) -> dict[str, Any]:
        """Everything that a reader of the results can check, without paths of this machine."""
        made_from = {**self.evaluation.content["made_from"]}
        for place in ("run", "demos"):
            made_from[place] = Path(made_from[place]).name
        made_from.pop("overrides", None)  # what they changed is said by the other entries
        columns = {key: None for row in self.curve for key in row}
        return {
            **self.evaluation.content,
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
        """One number of every seed's evaluation; none if one of them does not tell it."""
        found = [seed.evaluation.figure(key) for seed in self.seeds]
        known = [figure for figure in found if figure is not None]
        return known if len(known) == len(found) else []

    @property
    def seeds_by_distance_to_median(self) -> list[Seed]:
        """First the seed in the middle by return: what a user of the recipe may expect."""
        ordered = sorted(self.seeds, key=lambda seed: seed.evaluation.return_mean or 0.0)
        middle = len(ordered) // 2
        places = sorted(range(len(ordered)), key=lambda place: abs(place - middle))
        return [ordered[place] for place in places]


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
        RunDirectoryError: If it has no evaluation.
    """
    return Seed(
        load_evaluation(run_dir),
        tuple(read_lines(run_dir / LEARNING_CURVE)),
        tuple(read_lines(run_dir / ALARMS)),
        run_dir,
    )


def load_published(folder: Path) -> list[ResultRow]:
    """Reads what :func:`~pipeline.results.publish.publish` wrote to ``folder``; it may be nothing.

    Raises:
        RunDirectoryError: If a file is damaged.
    """
    rows: dict[str, list[Seed]] = {}
    for path in sorted((folder / ROWS).glob(f"*/{SEED}*.json")):
        seed = parse_published(path, load_evaluation(path).content)
        rows.setdefault(path.parent.name, []).append(seed)
    return [
        ResultRow(name, tuple(sorted(seeds, key=lambda s: s.seed))) for name, seeds in rows.items()
    ]


def parse_published(path: Path, content: Mapping[str, Any]) -> Seed:
    """The run of which a published file tells.

    Args:
        path: For messages.
        content: Of the file.

    Raises:
        RunDirectoryError: If it is damaged.
    """
    try:
        evaluation = dict(content)
        curve, alarms = evaluation.pop("curve"), evaluation.pop("alarms")
        points = zip(*curve.values(), strict=True)
        rows = in_order(dict(zip(curve, point, strict=True)) for point in points)
        return Seed(Evaluation.of(evaluation), tuple(rows), tuple(alarms))
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise RunDirectoryError(
            f"{path} is not a published run ({error}); restore or remove it"
        ) from error


def merge_rows(earlier: Sequence[ResultRow], later: Sequence[ResultRow]) -> list[ResultRow]:
    """All seeds of both; where both have a seed of a row, the later one counts.

    Raises:
        RunDirectoryError: If a row that gains seeds would hold those of different recipes.
    """
    rows: dict[str, dict[int, Seed]] = {}
    for row in (*earlier, *later):
        rows.setdefault(row.name, {}).update({seed.seed: seed for seed in row.seeds})
    merged = [
        ResultRow(name, tuple(seeds[number] for number in sorted(seeds)))
        for name, seeds in rows.items()
    ]
    added = {row.name for row in later}
    for row in merged:
        if row.name in added:
            _require_one_recipe(row)
    return merged


def _require_one_recipe(row: ResultRow) -> None:
    first, *others = (
        {**BEFORE_IT_WAS_NAMED, **seed.published()["made_from"]} for seed in row.seeds
    )
    for other in others:
        for key in RECIPE:
            if other.get(key) != first.get(key):
                raise RunDirectoryError(
                    f"row {row.name}: seed {first['seed']} has {key} {first.get(key)!r}, "
                    f"seed {other['seed']} has {other.get(key)!r}; publish to another folder "
                    f"(OUT=...), or remove {ROWS}/{row.name} from this one"
                )


def _short(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
