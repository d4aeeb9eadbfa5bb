"""What an evaluation tells on request besides the figures of every task; one module each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from tensordict.nn import TensorDictModuleBase

from envs import Task
from pipeline.act.metrics import Rollouts
from pipeline.act.recorder import SeesSteps
from pipeline.recipe import Recipe


@dataclass(frozen=True)
class Subject:
    """What is evaluated.

    Attributes:
        recipe: of the run.
        task: of which episodes are played.
        policy: that plays them.
    """

    recipe: Recipe
    task: Task
    policy: TensorDictModuleBase


@dataclass(frozen=True)
class Findings:
    """What an extra adds to an evaluation.

    Attributes:
        metrics: by key of ``evaluation.json``.
        columns: of ``episodes.csv``, a value per episode.
    """

    metrics: Mapping[str, Any]
    columns: Mapping[str, Sequence[Any]] = field(default_factory=dict)


class EvaluationExtra(Protocol):
    """Sees the steps of an evaluation and tells something of its episodes."""

    @property
    def recorder(self) -> SeesSteps:
        """What is shown the steps."""
        ...

    @property
    def env_options(self) -> Mapping[str, Any]:
        """What environments have to be made with besides, by field of `EnvOptions`."""
        ...

    def findings(self, rollouts: Rollouts) -> Findings:
        """Of the episodes; copies that stepped beside the last of them were recorded as well."""
        ...


AskedFor = Callable[[Subject], EvaluationExtra | None]
"""Makes an extra before anything is played; None where there is nothing to tell."""
