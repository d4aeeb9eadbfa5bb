"""An evaluated run and a group of runs: what tables, figures and reports are made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pipeline.files import again
from pipeline.files.run_files import RunDirectoryError
from pipeline.results.evaluation import Evaluation, MadeFrom, Versions
from pipeline.results.evaluation_files import Columns
from pipeline.results.robustness import Robustness

IN_SETTINGS: Final = {
    "task": "task.name",
    "demos": "demos.source",
    "bc_weight": "loss.bc_weight.init",
}
"""Dotted keys of the settings that an evaluation calls otherwise."""
DIGITS: Final = 6
"""Significant digits of published curves."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class EvaluatedRun:
    """One run: what is left of it in its directory, or in the file that was published of it.

    Attributes:
        path: the run directory or the file.
        evaluation_or_none: None where it has none that can be read; a report tells it all the same.
        curve: rows of the learning curve; empty for a run without one.
        alarms: that it raised.
        settings: values of the recipe by dotted key; empty where only a file is left.
        folder: name of the folder of its row, where it lies in one (``ROW/seedN``).
        episodes: of the evaluation, see ``pipeline.results.evaluation_files``.
        progress: likewise.
        seconds: of wall time by part.
        versions: that it was trained with.
        robustness: of the policy; None where nobody asked.
        missing: what could not be read and how to get it, a line each.
    """

    path: Path
    evaluation_or_none: Evaluation | None = None
    curve: Sequence[Row] = ()
    alarms: Sequence[Row] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    folder: str | None = None
    episodes: Columns = field(default_factory=dict)
    progress: Columns = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    versions: Versions = field(default_factory=Versions)
    robustness: Robustness | None = None
    missing: tuple[str, ...] = ()

    @property
    def evaluation(self) -> Evaluation:
        """Of the policy.

        Raises:
            RunDirectoryError: It has none.
        """
        if self.evaluation_or_none is None:
            raise RunDirectoryError(
                f"{self.path} is not evaluated; make it with: {again.evaluate(self.path)}"
            )
        return self.evaluation_or_none

    @property
    def made_from(self) -> MadeFrom | None:
        """What the evaluation was made from; None without one."""
        return None if self.evaluation_or_none is None else self.evaluation_or_none.made_from

    @property
    def seed(self) -> int:
        """Of the run."""
        return self.evaluation.made_from.seed

    @property
    def name(self) -> str:
        """Where it lies, in short: the last two parts of its path."""
        return "/".join(self.path.parts[-2:])

    def told(self, key: str) -> Any:
        """A value of the recipe, from the evaluation or else from the settings."""
        found = getattr(self.made_from, "task_name" if key == "task" else key, None)
        return self.settings.get(IN_SETTINGS.get(key, key)) if found is None else found

    def published(self) -> dict[str, Any]:
        """Everything that a reader of the results can check, without paths of this machine."""
        content = self.evaluation.content
        made_from = {**content["made_from"]}
        for place in ("run", "demos"):
            made_from[place] = Path(made_from[place]).name
        made_from.pop("overrides", None)  # what they changed is said by the other entries
        columns = {key: None for row in self.curve for key in row}
        return {
            **content,
            "made_from": made_from,
            "alarms": list(self.alarms),
            "curve": {key: [_short(row.get(key)) for row in self.curve] for key in columns},
        }


@dataclass(frozen=True)
class RunGroup:
    """Runs of one recipe, a row of a table: its seeds are the units of its intervals."""

    name: str
    runs: tuple[EvaluatedRun, ...]

    @property
    def evaluations(self) -> list[Evaluation]:
        """Of the runs that have one."""
        found = (run.evaluation_or_none for run in self.runs)
        return [evaluation for evaluation in found if evaluation is not None]

    @property
    def by_distance_to_median(self) -> list[EvaluatedRun]:
        """First the run in the middle by success, then return: what its user may expect."""
        ordered = sorted(self.runs, key=lambda run: _rank(run.evaluation))
        middle = len(ordered) // 2
        places = sorted(range(len(ordered)), key=lambda place: abs(place - middle))
        return [ordered[place] for place in places]

    def figures(self, key: str) -> list[float]:
        """One number of every evaluation; none if one of them does not tell it.

        Raises:
            ValueError: What an evaluation holds there is no number.
        """
        found = [evaluation.figure(key) for evaluation in self.evaluations]
        known = [figure for figure in found if figure is not None]
        return known if len(known) == len(found) else []

    def told(self, key: str) -> Any:
        """A value of the recipe, of the first run that tells it."""
        found = (run.told(key) for run in self.runs)
        return next((value for value in found if value is not None), None)


def _short(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _rank(evaluation: Evaluation) -> tuple[float, float]:
    return evaluation.figure("success_once") or 0.0, evaluation.return_mean or 0.0
