"""Run directories of a sweep: each of its runs has one of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

MULTIRUN: Final = frozenset({"-m", "--multirun"})
IN_DEFAULT: Final = frozenset({"variant", "preset", "seed"})
"""What the default of ``run_dir`` names already (train.yaml)."""
DEFAULT: Final = "runs/${hydra:runtime.choices.variant}-${hydra:runtime.choices.preset}-seed${seed}"
SAFE: Final = re.compile(r"[A-Za-z0-9._-]+")
"""A value that can be part of a folder's name as it is."""


def with_run_dirs(overrides: Sequence[str]) -> list[str]:
    """The overrides of a sweep, and where its runs are kept.

    The directory of a run says the value of every key that the sweep varies; the number of the
    job where a value cannot stand in a folder's name. A sweep of variants, presets and seeds keeps
    the default, which says them.

    Args:
        overrides: Of ``--multirun``.

    Raises:
        ValueError: If all runs are to be kept in one directory.
    """
    typed = [override for override in overrides if not override.startswith("-")]
    try:
        parsed = OverridesParser.create().parse_overrides(typed)
    except HydraException:
        return list(overrides)  # Hydra itself says what is wrong
    swept = {
        one.key_or_group: list(one.sweep_string_iterator())
        for one in parsed
        if one.is_sweep_override()
    }
    named = [one for one in parsed if one.key_or_group == "run_dir"]
    if named:
        if swept and "run_dir" not in swept and "${" not in str(named[-1].value()):
            raise ValueError(
                f"run_dir={named[-1].value()} is one directory, and a sweep has several runs; "
                "leave it out, or name what differs in it: run_dir='runs/mine-${seed}'"
            )
        return list(overrides)
    further = [key for key in swept if key not in IN_DEFAULT and not key.startswith("hydra.")]
    if not further:
        return list(overrides)
    plain = all(SAFE.fullmatch(value) for key in further for value in swept[key])
    parts = [f"{key}-${{{key}}}" for key in further] if plain else ["job${hydra:job.num}"]
    return [*overrides, f"run_dir={'-'.join([DEFAULT, *parts])}"]
