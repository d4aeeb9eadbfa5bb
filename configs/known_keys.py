"""Misspelt keys of a command line, refused with the one that was meant."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Final

from pipeline.dotted import names
from pipeline.files.run_files import PLACES
from pipeline.recipe import Recipe

CHOICES: Final = ("variant", "preset", *PLACES)
"""Keys that are no part of a recipe."""
PLAIN: Final = re.compile(r"([a-z_][a-z0-9_.]*)=", re.IGNORECASE)
"""Begins an override of a value; Hydra's own (``+new=1``, ``~gone``, ``hydra.x=1``) are its own."""


def require_known(overrides: Sequence[str]) -> None:
    """Refuse a key that no recipe has; Hydra's own words for it advise to add it.

    Args:
        overrides: ``key=value`` each, under today's names.

    Raises:
        ValueError: naming the key and those most like it.
    """
    values = Recipe().plain()
    keys = [*CHOICES, *names(values)]
    for override in overrides:
        found = PLAIN.match(override)
        if found is None or found[1] in keys or found[1].startswith("hydra."):
            continue
        alike = get_close_matches(found[1], keys, n=3)
        meant = f"did you mean {' or '.join(alike)}? All" if alike else "all"
        raise ValueError(f"there is no key {found[1]}: {meant} are in docs/reference/settings.md")
