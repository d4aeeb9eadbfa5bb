"""``make eval DEMOS=``'s ``likeness``: how alike the episodes are to demonstrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, cast

from pipeline.act.metrics import Rollouts
from pipeline.act.policy_wrappers import unwrapped
from pipeline.act.recorder import Recorder
from pipeline.commands.extras import Findings, Subject
from pipeline.machine.extras import require_extras

if TYPE_CHECKING:
    from torchrl.modules import ProbabilisticActor

    from pipeline.act.likeness import Comparison

COMPARED: Final = 100
"""Episodes that are compared: enough for a median."""


@dataclass(frozen=True)
class LikenessTo:
    """What the first episodes are to be compared to.

    Attributes:
        source: of demonstrations.
    """

    source: str

    def __call__(self, subject: Subject) -> LikenessTold:
        """The extra, with the demonstrations read.

        Raises:
            MissingExtraError: A package that it needs is not installed.
            MissingCapabilityError, DemonstrationError: As `Comparison.to`.
        """
        require_extras(["dtaidistance"], f"make eval DEMOS={self.source}")
        from pipeline.act.likeness import Comparison  # noqa: PLC0415 - needs the extra

        recipe = subject.recipe
        # The density of several actions at once says nothing of one of them.
        alone = recipe.actor.chunk == 1
        return LikenessTold(
            Comparison.to(self.source, subject.task, COMPARED),
            cast("ProbabilisticActor", unwrapped(subject.policy)) if alone else None,
            recipe.loss.action_margin,
        )


@dataclass(frozen=True)
class LikenessTold:
    """Compares what was recorded.

    Attributes:
        comparison: to the demonstrations.
        actor: of one action at a time; None for others.
        margin: of their actions, see `mean_nll`.
    """

    comparison: Comparison
    actor: ProbabilisticActor | None
    margin: float

    @property
    def env_options(self) -> Mapping[str, Any]:
        """Nothing besides."""
        return {}

    @property
    def recorder(self) -> Recorder:
        """Of the first episodes."""
        return self.comparison.recorder

    def findings(self, rollouts: Rollouts) -> Findings:
        """The figures of `Comparison`."""
        return Findings({"likeness": self.comparison.figures(rollouts, self.actor, self.margin)})
