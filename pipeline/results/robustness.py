"""What ``make robust`` leaves: success under each disturbance, and the first that breaks a policy.

A ladder is one kind of disturbance in one direction, from the weakest setting to the strongest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Self

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from tabulate import tabulate

from pipeline.files import again
from pipeline.files.run_files import RunDirectoryError, as_json, write_atomically
from pipeline.results.evaluation import Share, first_fault

ROBUSTNESS: Final = "robustness.json"
TABLE: Final = "robustness.md"
FIGURE: Final = "robustness.png"
EPISODES: Final = 200
"""Of a setting, unless another number is asked for: a share of 0.9 has an interval of +- 0.04."""
BAR: Final = 0.9
"""Success below which a setting breaks a policy, likewise."""
CHECKED: Final = ConfigDict(allow_inf_nan=False)


@dataclass(frozen=True, config=CHECKED)
class Measured:
    """Episodes under one setting.

    Attributes:
        setting: in short: ``x2``, ``+0.02 m``, ``3 steps``.
        success: share of the episodes that succeed at any step; None where it was refused.
        ci95: Wilson's interval of it.
        return_mean: undiscounted.
        refused: why nothing was played; None where it was.
    """

    setting: str
    success: Share | None = None
    ci95: tuple[Share, Share] | None = None
    return_mean: float | None = None
    refused: str | None = None

    @property
    def text(self) -> str:
        """For tables: success and its interval in per cent."""
        if self.success is None or self.ci95 is None:
            return "refused"
        low, high = (100 * edge for edge in self.ci95)
        return f"{100 * self.success:.1f} [{low:.1f}, {high:.1f}]"


@dataclass(frozen=True, config=CHECKED)
class Ladder:
    """Settings of one kind, the weakest first."""

    kind: str
    what: str
    """In words: ``friction of all contacts, more``."""
    settings: tuple[Measured, ...]

    @property
    def unbroken(self) -> str:
        """What to say where no setting breaks a policy."""
        played = any(m.success is not None for m in self.settings)
        return "none of these" if played else "none was played"

    def first_below(self, bar: float) -> str | None:
        """The weakest setting under which success is below ``bar``; None if there is none."""
        broken = (m.setting for m in self.settings if m.success is not None and m.success < bar)
        return next(broken, None)


@dataclass(frozen=True, config=CHECKED)
class Robustness:
    """A policy under all ladders.

    Attributes:
        bar: success below which a setting breaks the policy.
        episodes: of each setting.
        undisturbed: the same episodes without any.
        ladders: of every kind.
        made_from: run, seeds, versions.
        kinds: of ladders that were asked for; none are all.
    """

    bar: float
    episodes: int
    undisturbed: Measured
    ladders: tuple[Ladder, ...]
    made_from: Mapping[str, Any]
    kinds: tuple[str, ...] = ()

    @property
    def weak(self) -> bool:
        """Whether the policy is below the bar without any disturbance: none can be blamed."""
        return self.undisturbed.success is not None and self.undisturbed.success < self.bar

    def first_below(self, ladder: Ladder) -> str | None:
        """The weakest setting of a ladder below the bar, ``undisturbed`` where that is."""
        return self.undisturbed.setting if self.weak else ladder.first_below(self.bar)

    def write(self, folder: Path) -> None:
        """Writes the numbers and the table into ``folder``, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / TABLE, self.markdown() + "\n")
        told = asdict(self)
        for ladder, plain in zip(self.ladders, told["ladders"], strict=True):
            plain["first_below"] = self.first_below(ladder)
        write_atomically(folder / ROBUSTNESS, as_json(told, indent=2) + "\n")

    @classmethod
    def read(cls, path: Path) -> Self:
        """What :meth:`write` left.

        Raises:
            RunDirectoryError: If it is missing or damaged.
        """
        remedy = f"make it with: {again.command('robust', path.parent, again.task_of(path.parent))}"
        try:
            return TypeAdapter(cls).validate_json(path.read_text(), strict=True)
        except OSError as error:
            raise RunDirectoryError(
                f"{path} cannot be read ({error.strerror}); {remedy}"
            ) from error
        except ValidationError as error:
            told = first_fault(error)
            raise RunDirectoryError(f"{path} is damaged ({told}); {remedy}") from error
        except ValueError as error:  # bytes that are no text
            raise RunDirectoryError(f"{path} is damaged ({error}); {remedy}") from error

    def rows(self) -> list[list[str]]:
        """A line a ladder: what, its settings with their success, what breaks it."""
        return [
            [
                ladder.what,
                *(f"{m.setting}: {m.text}" for m in ladder.settings),
                *[""] * (self.most - len(ladder.settings)),
                "undisturbed already"
                if self.weak
                else ladder.first_below(self.bar) or ladder.unbroken,
            ]
            for ladder in self.ladders
        ]

    @property
    def most(self) -> int:
        """Settings of the longest ladder."""
        return max((len(ladder.settings) for ladder in self.ladders), default=0)

    @property
    def headers(self) -> list[str]:
        """Of :meth:`rows`."""
        levels = [f"level {i + 1}" for i in range(self.most)]
        return ["disturbance", *levels, f"first below {100 * self.bar:g} %"]

    @property
    def command(self) -> str:
        """That makes it again."""
        return again.command(
            "robust",
            self.made_from["run"],
            {"name": self.made_from.get("task")},
            self.made_from.get("overrides") or (),
            EPISODES=self.episodes,
            BAR=f"{self.bar:g}",
            ONLY=",".join(self.kinds),
        )

    def markdown(self) -> str:
        """The table, with what it is of."""
        made = self.made_from
        return "\n".join(
            [
                f"# Robustness of `{Path(str(made['run'])).name}`",
                "",
                f"Success in % of {self.episodes} episodes of each setting (seed "
                f"{made['evaluation_seed']}), with Wilson's 95 % interval. Undisturbed: "
                f"{self.undisturbed.text}.",
                *_weakness(self),
                f"Again: `{self.command}`.",
                "",
                tabulate(self.rows(), self.headers, tablefmt="github", disable_numparse=True),
                *_refusals(self.ladders),
            ]
        )


def _weakness(found: Robustness) -> list[str]:
    bar = f"{100 * found.bar:g} %"
    told = f"The undisturbed policy is itself below the bar of {bar}: no setting is what breaks it."
    return [told] if found.weak else []


def _refusals(ladders: Sequence[Ladder]) -> list[str]:
    found = [m.refused for ladder in ladders for m in ladder.settings if m.refused]
    return ["", *(f"- refused: {reason}" for reason in found)] if found else []
