"""One module for each format of demonstration files; whoever adds one edits nothing else.

A module here that has a ``READER`` (`envs.demonstrations.reading.Reader`) is a format.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from envs.demonstrations.reading import Reader


@cache
def find_readers() -> tuple[Reader, ...]:
    """Every reader of this package, in the order of its modules' names."""
    modules = (
        import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)
    )
    return tuple(module.READER for module in modules if hasattr(module, "READER"))
