"""An alarm when a policy unlearns, with the known causes that it looks like."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pipeline.files.curves import in_order

SUCCESS = "success_once"
WORTH_LOSING = 0.2
"""Success below which a fall is noise of a few evaluation episodes."""
FALL = 0.5
"""Share of the best success so far at which the alarm goes off."""
NATS = 5.0
"""Change of an entropy or a likelihood that counts."""
PREFERENCE = 0.1
"""Growth of the critics' preference for the policy's actions, relative to the values, that counts.
"""
FADED = 0.5
"""Size of the imitation gradient, relative to the RL gradient, below which it no longer holds."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Alarm:
    """A policy that lost half of its best success after the RL term came on."""

    frames: float
    success: float
    best_success: float
    best_frames: float
    causes: tuple[str, ...]
    """What it looks like, most specific first."""

    def __str__(self) -> str:
        """One paragraph for a person."""
        return (
            f"unlearning: {self.success:.0%} of the episodes succeed at {self.frames:.0f} "
            f"frames, {self.best_success:.0%} at {self.best_frames:.0f}. It looks like: "
            + "; ".join(self.causes)
        )


def unlearning(curve: Sequence[Row]) -> Alarm | None:
    """The alarm that the last row of a learning curve raises, if it is the first row of a fall.

    Args:
        curve: Rows of ``learning_curve.jsonl``, read in the order of their frames. Rows without a
            success rate (other tasks) or from before the first actor update raise nothing.
    """
    rows = [row for row in in_order(curve) if row.get(SUCCESS) is not None]
    if len(rows) < 2 or not _number(rows[-1], "actor_updates"):
        return None
    now, earlier = rows[-1], rows[:-1]
    best = max(earlier, key=_success)
    limit = FALL * _success(best)
    if _success(best) < WORTH_LOSING or _success(now) > limit:
        return None
    if best is not earlier[-1] and _success(earlier[-1]) <= limit:
        return None  # it had fallen already
    causes = tuple(text for cause in CAUSES if (text := cause(best, now)))
    return Alarm(
        frames=_number(now, "frames") or 0.0,
        success=_success(now),
        best_success=_success(best),
        best_frames=_number(best, "frames") or 0.0,
        causes=causes or ("none of the known causes",),
    )


def _overestimation(best: Row, now: Row) -> str | None:
    before, after = _preference(best), _preference(now)
    scale = abs(_number(now, "q_demo_actions") or 0.0)
    if before is None or after is None or after - before <= PREFERENCE * scale:
        return None
    return (
        f"overestimation (the critics value the policy's actions {after:+.2f} against the "
        f"demonstrated ones, {before:+.2f} at the best; try more critics, loss.target_subset=null, "
        "a longer optim.actor_delay, a larger sampler.demo_ratio)"
    )


def _faded_imitation(_best: Row, now: Row) -> str | None:
    weight, bc, rl = (_number(now, k) for k in ("bc_weight", "grad_norm_bc", "grad_norm_rl"))
    if weight is None or bc is None or rl is None or weight * bc >= FADED * rl:
        return None
    share = weight * bc / rl if rl else float("inf")
    return (
        f"faded imitation (its gradient is {share:.2f} of the RL gradient; try a slower "
        "loss.bc_weight.decay or loss.bc_gradient_ratio)"
    )


def _widening(best: Row, now: Row) -> str | None:
    change = _rise(best, now, "entropy")
    if change is None:
        return None
    return (
        f"entropy bonus (the policy's entropy rose by {change:.1f} nats; try "
        "loss.entropy_in_target=false, a smaller loss.init_temperature or loss.target_entropy)"
    )


def _forgetting(best: Row, now: Row) -> str | None:
    change = _rise(best, now, "bc_nll_train")
    if change is None:
        return None
    return (
        f"leaving the demonstrations (bc_nll_train, the imitation error, rose by {change:.1f}; try "
        "a smaller optim.actor_lr or a larger imitation weight)"
    )


def _stopping(best: Row, now: Row) -> str | None:
    """Where the episodes that are lost now stop: between which two stages of the task."""
    before, after = _stops(best), _stops(now)
    lost = _success(best) - _success(now)
    if not before or before.keys() != after.keys():
        return None
    (last, missed), more = max(
        ((stop, after[stop] - before[stop]) for stop in after), key=lambda found: found[1]
    )
    if more < FALL * lost:
        return None
    return (
        f"stopping before '{missed}' (of the {lost:.0%} lost, {more:.0%} get as far as '{last}'; "
        "compare with evaluation.exploration=sample, try backtrack.level=0.02 or demonstrations "
        "that go further: demos.multiply.min_progress)"
    )


def _mean_action(best: Row, now: Row) -> str | None:
    sampled = _number(now, "train_success")
    lost = _success(best) - _success(now)
    if sampled is None or sampled - _success(now) < FALL * lost:
        return None
    return (
        f"the evaluated action alone (training's samples succeed in {sampled:.0%} there: "
        "the policy has learned with its noise; try loss.target_action=mean, collector.greedy_envs)"
    )


CAUSES: tuple[Callable[[Row, Row], str | None], ...] = (
    _mean_action,
    _overestimation,
    _widening,
    _faded_imitation,
    _forgetting,
    _stopping,
)
"""Each takes the best row and the present one, and says what it sees or None."""


def _number(row: Row, key: str) -> float | None:
    value = row.get(key)
    return None if value is None else float(value)


def _success(row: Row) -> float:
    return _number(row, SUCCESS) or 0.0


def _stops(row: Row) -> dict[tuple[str, str], float]:
    """Share of episodes that reach a stage and not the next one, by the two stages' labels."""
    shares: Any = row.get("stages") or {}
    passed = [("the start", 1.0), *shares.items()]
    return {(a, b): float(x) - float(y) for (a, x), (b, y) in pairwise(passed)}


def _rise(best: Row, now: Row, key: str) -> float | None:
    """By how much ``key`` rose since the best row; None for at most ``NATS``."""
    before, after = _number(best, key), _number(now, key)
    if before is None or after is None or after - before <= NATS:
        return None
    return after - before


def _preference(row: Row) -> float | None:
    own, shown = _number(row, "q_policy_actions"), _number(row, "q_demo_actions")
    return None if own is None or shown is None else own - shown
