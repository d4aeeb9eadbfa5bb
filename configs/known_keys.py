"""Misspelt keys, variants and presets of a command line, refused with the one that was meant."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from pipeline.dotted import names
from pipeline.files.run_files import PLACES
from pipeline.recipe import Recipe
from pipeline.settings import unknown_key

CHOICES: Final = ("variant", "preset", *PLACES)
"""Keys that are no part of a recipe."""
PLAIN: Final = re.compile(r"([a-z_][a-z0-9_.]*)=", re.IGNORECASE)
"""Begins an override of a value; Hydra's own (``+new=1``, ``~gone``, ``hydra.x=1``) are its own."""
CHOSEN: Final = re.compile(r"(variant|preset)=([A-Za-z0-9_,]+)")
"""Chooses files of ours by name; a sweep separates several by commas."""
OTHERS: Final = ("hydra.searchpath=", "--config-dir", "-cd")
"""Begin what adds somebody's own folder of files, among which Hydra looks a name up."""


def require_known(overrides: Sequence[str]) -> None:
    """Refuse a key that no recipe has, and a variant or preset that does not exist.

    Hydra's own words advise to add the key, and list the choices behind its search path.

    Args:
        overrides: ``key=value`` each, under today's names.

    Raises:
        ValueError: naming what is unknown and what is most like it.
    """
    if not any(override.startswith(OTHERS) for override in overrides):
        for override in overrides:
            if found := CHOSEN.fullmatch(override):
                _require_file(found[1], found[2].split(","))
    values = Recipe().plain()
    keys = [*CHOICES, *names(values)]
    for override in overrides:
        found = PLAIN.match(override)
        if found is None or found[1] in keys or found[1].startswith("hydra."):
            continue
        raise ValueError(unknown_key(found[1], keys))


def _require_file(group: str, names: Sequence[str]) -> None:
    known = sorted(path.stem for path in (Path(__file__).parent / group).glob("*.yaml"))
    for name in names:
        if name not in known:
            alike = get_close_matches(name, known, n=3)
            meant = f"did you mean {' or '.join(alike)}? All: " if alike else ""
            raise ValueError(f"there is no {group} {name}: {meant}{', '.join(known)}")
