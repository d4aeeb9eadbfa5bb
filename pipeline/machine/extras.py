"""Optional dependencies, asked for before any work is done."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Final

EXTRAS: Final = {
    "PIL": "video",
    "dtaidistance": "likeness",
    "imageio": "video",
    "imageio_ffmpeg": "video",
    "jinja2": "report",
    "matplotlib": "results",
    "mlflow": "mlflow",
    "pandas": "results",
    "plotly": "report",
    "rliable": "results",
    "wandb": "wandb",
}
"""The extra of ``pyproject.toml`` that brings a module."""


class MissingExtraError(ValueError):
    """An optional dependency is not installed; the message names its extra."""


def require_extras(modules: Iterable[str], wanted_by: str) -> None:
    """Looks for modules without importing them; those that belong to no extra are there anyway.

    Args:
        modules: Their names.
        wanted_by: A command or setting, for the message.

    Raises:
        MissingExtraError: If one is missing.
    """
    for module in modules:
        if module in EXTRAS and module not in sys.modules and find_spec(module) is None:
            extra = EXTRAS[module]
            raise MissingExtraError(
                f"{wanted_by} needs {module}, which comes with the extra {extra!r}: "
                f"pip install 'bc-sac[{extra}]', or in a checkout make install EXTRAS={extra}"
            )
