"""Which runs are of one recipe, and in what recipes differ."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Container, Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

from pipeline.files.run_files import HISTORY
from pipeline.results.runs import EvaluatedRun, RunGroup

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
"""What the seeds of one row have in common, as an evaluation tells it."""
OF_THE_MACHINE = frozenset(
    {"seed", "cache_dir", "device", "torch_threads", "compile_updates", "onednn", "cuda_graphs"}
    | {"env.num_threads", "env.workers", "demos.multiply.seed"}
)
"""Keys whose values do not make another recipe."""
NOT_OF_THE_RECIPE = ("logging.", HISTORY)
"""Nor what a run was before it was resumed: its other keys hold what it ended as."""
SHOWN, VALUE_LENGTH = 3, 24
"""Differing keys in the name of a row, and characters of each value."""


def group(runs: Sequence[EvaluatedRun]) -> list[RunGroup]:
    """Rows in the order of their first run.

    ``ROW/seedN`` is of row ``ROW``; other runs are together if their recipes are equal but for the
    seed and what is the machine's, and are called after the variant and what differs.
    """
    named: defaultdict[str, dict[str, list[EvaluatedRun]]] = defaultdict(dict)
    for run in runs:
        name = run.folder or str(run.told("variant") or run.path.stem)
        identity = "" if run.folder else json.dumps(recipe(run), sort_keys=True, default=str)
        named[name].setdefault(identity, []).append(run)
    rows: dict[str, RunGroup] = {}
    for name, groups in named.items():
        recipes = [recipe(members[0]) for members in groups.values()]
        keys = different(recipes)
        for members, values in zip(groups.values(), recipes, strict=True):
            told = ", ".join(f"{key}={_shortened(values.get(key))}" for key in keys[:SHOWN])
            label = _unlike(f"{name} ({told})" if keys else name, rows)
            rows[label] = RunGroup(label, tuple(members))
    return list(rows.values())


def recipe(run: EvaluatedRun) -> Mapping[str, Any]:
    """What decides what a run learns, by dotted key; of the evaluation if it has no configuration.

    Of paths only names count: others have other folders.
    """
    if not run.settings:
        return {key: _short(run.told(key)) for key in RECIPE}
    return {
        key: _short(value)
        for key, value in run.settings.items()
        if key not in OF_THE_MACHINE and not key.startswith(NOT_OF_THE_RECIPE)
    }


def different(recipes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys that do not have one value, in their order."""
    keys = {key: None for values in recipes for key in values}
    return [key for key in keys if any(r.get(key) != recipes[0].get(key) for r in recipes)]


def _shortened(value: Any) -> str:
    text = str(value)
    return text if len(text) <= VALUE_LENGTH else f"{text[: VALUE_LENGTH - 3]}..."


def _unlike(label: str, others: Container[str]) -> str:
    """The label, numbered where what is left out of it is all that tells two rows apart."""
    numbered = (f"{label} #{number}" for number in count(2))
    return next(one for one in chain([label], numbered) if one not in others)


def _short(value: Any) -> Any:
    return Path(value).name if isinstance(value, str) and "/" in value else value
