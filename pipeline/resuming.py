"""What a run that goes on may change, and what its directory tells about it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from tabulate import tabulate

from pipeline import compute, entropy_choice, imitation_choice, scale_choice
from pipeline.dotted import flatten, nest
from pipeline.files.run_files import RunDirectoryError
from pipeline.recipe import Recipe

MAY_CHANGE: Final = (
    "device",
    "torch_threads",
    "compile_updates",
    "onednn",
    "cuda_graphs",
    "cache_dir",
    "env.num_threads",
    "env.workers",
    "evaluation",
    "logging",
)
"""Keys and sections that a run which goes on may change: the machine, what is measured and logged.
docs/howto/runs.md lists them."""
ONLINE: Final = (
    "collector.total_frames",
    "optim.actor_lr",
    "optim.critic_lr",
    "optim.temperature_lr",
)
"""Besides, with an environment: the budget and the rates."""
OFFLINE: Final = ("bc.updates", "bc.lr")
"""Besides, without one."""
DECIDED: Final[Mapping[str, object]] = {
    **compute.OPEN,
    **scale_choice.OPEN,
    **imitation_choice.OPEN,
    **entropy_choice.OPEN,
}
"""Keys that a run decides when it starts, by the value that leaves them open."""

Changes = Mapping[str, tuple[Any, Any]]
"""Old and new value by key."""


def as_decided(asked: Recipe, saved: Recipe) -> Recipe:
    """What ``asked`` leaves open is what the run decided: it goes on computing as it did."""
    wanted, decided = flatten(asked.plain()), flatten(saved.plain())
    for key, open_value in DECIDED.items():
        if wanted[key] == open_value:
            asked = asked.changed(**nest(key, decided[key]))
    return asked


def changes(saved: Recipe, asked: Recipe) -> Changes:
    """In which keys the two differ."""
    old, new = flatten(saved.plain()), flatten(asked.plain())
    keys = dict.fromkeys([*old, *new])
    return {key: (old.get(key), new.get(key)) for key in keys if old.get(key) != new.get(key)}


def require_changeable(changed: Changes, recipe: Recipe, run_dir: Path) -> None:
    """Refuses changes that would make another run of it.

    Raises:
        RunDirectoryError: With a table of old and new values.
    """
    allowed = (*MAY_CHANGE, *(OFFLINE if recipe.offline else ONLINE))
    refused = {
        key: values
        for key, values in changed.items()
        if not any(key == one or key.startswith(f"{one}.") for one in allowed)
    }
    if refused:
        rows = [(key, _shown(old), _shown(new)) for key, (old, new) in refused.items()]
        table = tabulate(rows, headers=("key", "of the run", "asked for"), disable_numparse=True)
        raise RunDirectoryError(
            f"{run_dir} was made with other values, and a run that goes on cannot change them:\n"
            f"{table}\nLeave them out, or start another run with RUN=<new directory>. "
            f"What may change: {', '.join(allowed)}."
        )


def require_budget(recipe: Recipe, counted: int, run_dir: Path, changed: Changes) -> None:
    """Refuses a budget that is smaller than what the run has ``counted`` already.

    Raises:
        RunDirectoryError: If the run has passed the budget that is asked for.
    """
    key, unit = recipe.budget.key, recipe.budget.unit
    if key in changed and changed[key][1] < counted:
        raise RunDirectoryError(
            f"{run_dir} has {counted} {unit} already, and {key}={changed[key][1]} asks for fewer: "
            f"ask for at least {counted}, or start another run with RUN=<new directory>."
        )


def entry(changed: Changes, frames: int) -> dict[str, Any]:
    """What ``config.yaml`` records of a resume with other values."""
    return {
        "frames": frames,
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "changed": {key: [old, new] for key, (old, new) in changed.items()},
    }


def _shown(value: Any) -> str:
    return "null" if value is None else str(value)
