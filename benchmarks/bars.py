"""What the project wants to reach, and whether the measurements do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.statistics import rounded

Results = Mapping[str, Any]


@dataclass(frozen=True)
class Bar:
    """One wanted number."""

    what: str
    sense: Literal[">=", "<="]
    wanted: float
    measure: Callable[[Results], float]
    """From the result file; raises ``KeyError`` or ``TypeError`` where it was not measured."""

    def evaluate(self, results: Results) -> dict[str, Any]:
        """Measured, wanted and met; None where it was not measured."""
        try:
            measured = rounded(self.measure(results), 3)
        except (KeyError, TypeError):
            return {"what": self.what, "wanted": self._wanted, "measured": None, "met": None}
        met = measured >= self.wanted if self.sense == ">=" else measured <= self.wanted
        return {"what": self.what, "wanted": self._wanted, "measured": measured, "met": met}

    @property
    def _wanted(self) -> str:
        return f"{self.sense} {self.wanted:g}"


def _faster(size: str, other: str) -> Callable[[Results], float]:
    return lambda results: results["update"][size][other] / results["update"][size]["ours_bc_sac"]


def _own_ceiling_share(results: Results) -> float:
    # Of the bf16 run: an fp32 one may well exceed a bf16 ceiling where bf16 is the slower.
    return float(results["update"]["1024"]["roofline"]["ours_bc_sac_bf16"]["of_own_precision"])


def _best_ceiling_share(results: Results) -> float:
    block = results["update"]["1024"]
    return float(block["roofline"][block["fastest"]["ours_bc_sac"]]["of_fastest"])


def _doors(other: str) -> Callable[[Results], float]:
    return lambda results: (
        results["env_steps_per_s"]["doors_64_threads_2"] / results["env_steps_per_s"][other]
    )


BARS = (
    Bar("bc_sac 1024x1024/B1024: times faster than sb3's SAC", ">=", 2.5, _faster("1024", "sb3")),
    Bar("bc_sac 1024x1024/B1024: times faster than sbx's SAC", ">=", 1.6, _faster("1024", "sbx")),
    Bar("bc_sac 1024x1024/B1024 in bf16: share of bf16 ceiling", ">=", 0.65, _own_ceiling_share),
    Bar("bc_sac 1024x1024/B1024: share of the fastest ceiling", ">=", 0.65, _best_ceiling_share),
    Bar("bc_sac 256x256/B256: times faster than sb3's SAC", ">=", 2.5, _faster("256", "sb3")),
    Bar("bc_sac 256x256/B256: times faster than sbx's SAC", ">=", 1.4, _faster("256", "sbx")),
    Bar("64 doors, 2 threads: times one raw door, 1 thread", ">=", 1.8, _doors("raw_threads_1")),
    Bar(
        "64 doors, 2 threads: times gymnasium-robotics",
        ">=",
        2.5,
        _doors("gymnasium_robotics_threads_1"),
    ),
    Bar(
        "1000-door evaluation: times the raw physics, 2 threads",
        "<=",
        1.25,
        lambda results: results["evaluation_1000"]["ratio"],
    ),
    Bar(
        "default make train: share of the wall time in updates and physics",
        ">=",
        0.75,
        lambda results: results["train_breakdown"]["productive_share"],
    ),
    Bar(
        "dbc_sac, paper preset, 100,000 frames: hours",
        "<=",
        3.0,
        lambda results: results["paper_preset"]["hours"],
    ),
    Bar("RLPD-sized frame: ms", "<=", 150.0, lambda results: results["rlpd_frame"]["ours"]),
    Bar(
        "RLPD-sized frame: times faster than torchrl's REDQLoss",
        ">=",
        3.0,
        lambda results: results["rlpd_frame"]["ratio"],
    ),
)


def evaluate(results: Results) -> list[dict[str, Any]]:
    """Every bar against the result file."""
    return [bar.evaluate(results) for bar in BARS]
