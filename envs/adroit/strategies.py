"""How a hand goes about a task, told from what it touches while the thing moves.

The *travel* of an episode is how far its progress rises, from where it has begun to move to the
first success, or to its largest progress where there is none. Each control step counts by what it
adds, so that a slow reach counts nothing. A step is *opposed* where the thumb and another part
press on what is held, from opposite sides. The classes, by the first that fits:

======== ======================================================================================
untouched nothing was moved (progress rose by at most `Contacts.moved`), what is held never touched
touched   likewise, and touched
short     moved, without success
flung     no contact at all for `Thresholds.untouched` of the travel or more, and not less than
          elsewhere
elsewhere the hand on other targets alone for `Thresholds.elsewhere` of the travel or more
grasp     an opposed grasp for `Thresholds.grasp` of the travel or more
held      what is left: led, and less opposed
======== ======================================================================================

A class says nothing of what comes after the first success.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray
from tensordict import TensorDictBase

from envs.adroit.touch import FORCES, OPPOSITION, Contacts
from envs.strategies import Ways, shares

STRATEGIES: Final = ("grasp", "held", "flung", "elsewhere", "short", "touched", "untouched")
QUANTILES: Final = (0.1, 0.5, 0.9)
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Thresholds:
    """Where one class ends and the next begins.

    Attributes:
        force: normal force (N) above which a part touches.
        gap: control steps by which a touch is taken to last longer at either end: contacts chatter.
        opposition: cosine below which thumb and hand press from opposite sides.
        grasp: share of the travel that an opposed grasp leads.
        untouched: share of the travel without any contact.
        elsewhere: share of the travel with other targets touched alone.
    """

    force: float = 0.05
    gap: int = 2
    opposition: float = -0.3
    grasp: float = 0.6
    untouched: float = 0.25
    elsewhere: float = 0.25


DEFAULT: Final = Thresholds()

SENSITIVITY: Final[Mapping[str, Sequence[float]]] = {
    "untouched": (0.1, 0.25, 0.5),
    "grasp": (0.4, 0.6, 0.8),
    "opposition": (0.0, -0.3, -0.6),
    "force": (0.01, 0.05, 0.5),
    "gap": (0, 2, 5),
}
"""Values of thresholds that are tried one at a time, to see which shares hang on them."""


@dataclass(frozen=True)
class HandStrategies:
    """Tells the strategies of a task of the hand, as `envs.task.Task.strategies`.

    Attributes:
        contacts: What its environments record.
        thresholds: Of the classes.
    """

    contacts: Contacts
    thresholds: Thresholds = DEFAULT

    @property
    def words(self) -> Mapping[str, str]:
        """The classes, and what they are called in this task."""
        return self.contacts.words

    @property
    def columns(self) -> tuple[str, ...]:
        """Forces and the thumb's opposition."""
        return FORCES, OPPOSITION

    def told(
        self,
        seen: Mapping[str, NDArray[Any]],
        progress: NDArray[Any] | None,
        success: NDArray[Any] | None,
    ) -> Ways:
        """Classes of episodes, and how many would be told otherwise at other thresholds.

        Args:
            seen: Normal forces (N) after each step, [E, T, P * K], and the opposition of the thumb,
                [E, T, 1]; zeros behind an episode's end.
            progress: [E, T], NaN behind the end.
            success: [E, T].

        Returns:
            Beside the classes, over the episodes: quantiles of the progress when what is held was
            last touched, up to the end of the travel, and of the travel's share without any
            contact; each part's share of the normal force on what is held; the thresholds, and the
            classes' shares at other values of them.
        """
        assert progress is not None, "every task of the hand tells its progress"
        assert success is not None, "and its success"
        contacts, opposition = self.contacts, seen[OPPOSITION][..., 0]
        parts, targets = len(contacts.parts), len(contacts.targets)
        forces = seen[FORCES].reshape(*opposition.shape, parts, targets)

        def classed(**changed: Any) -> list[_Told]:
            at = replace(self.thresholds, **changed)
            touch = _Touches.of(contacts, forces, opposition, at)
            return [
                _told(contacts, touch, i, progress[i], success[i], at) for i in range(len(forces))
            ]

        found = classed()
        last = np.array([told.last_contact for told in found])
        untouched = np.array([told.untouched for told in found])
        return Ways(
            names=[told.name for told in found],
            figures={
                "progress_at_last_contact": _quantiles(last),
                "travel_untouched": _quantiles(untouched),
                "travel_untouched_mean": _mean(untouched),
                "force_by_part": _by_part(contacts, forces),
                "thresholds": asdict(self.thresholds),
                "sensitivity": {
                    name: {f"{value:g}": _shares(classed(**{name: value})) for value in values}
                    for name, values in SENSITIVITY.items()
                },
            },
            columns={
                "progress_at_last_contact": _or_none(last),
                "travel_untouched": _or_none(untouched),
            },
        )

    def now(self, seen: TensorDictBase) -> str:
        """What touches what: ``palm, thumb: handle; first: panel``."""
        return self.contacts.touching(seen[FORCES][0].cpu().numpy(), self.thresholds.force)


@dataclass(frozen=True)
class _Touches:
    """What is touched at each step, [E, T]."""

    held: Bools
    elsewhere: Bools
    opposed: Bools
    exactly: Bools
    """held, without the gaps closed."""

    @classmethod
    def of(
        cls,
        contacts: Contacts,
        forces: NDArray[np.float32],
        opposition: NDArray[np.float32],
        at: Thresholds,
    ) -> _Touches:
        touched = forces > at.force
        targets = [name in contacts.held for name in contacts.targets]
        on_held = np.asarray(touched[..., targets].any(axis=-1))  # [E, T, P]
        thumb = contacts.parts.index(contacts.thumb)
        opposed = on_held[..., thumb] & np.delete(on_held, thumb, axis=-1).any(axis=-1)
        others = np.asarray(touched[..., np.logical_not(targets)].any(axis=(-1, -2)))
        held = np.asarray(on_held.any(axis=-1))
        return cls(
            held=_lasting(held, at.gap),
            elsewhere=_lasting(others, at.gap),
            opposed=_lasting(opposed & (opposition < at.opposition), at.gap),
            exactly=held,
        )


@dataclass(frozen=True)
class _Told:
    name: str
    last_contact: float
    untouched: float


def _told(
    contacts: Contacts,
    touch: _Touches,
    episode: int,
    progress: NDArray[np.floating],
    success: Bools,
    at: Thresholds,
) -> _Told:
    known = progress[np.isfinite(progress)].astype(np.float64)
    gained = known - known[0]
    end = int(success.argmax()) if success.any() else int(gained.argmax())
    exactly = touch.exactly[episode]
    steps = np.flatnonzero(exactly[: end + 1])
    last = float(known[steps[-1]]) if len(steps) else float("nan")
    if gained.max() <= contacts.moved:
        return _Told("touched" if exactly.any() else "untouched", last, float("nan"))
    travel = np.diff(gained[: end + 1], prepend=gained[0]).clip(min=0.0)
    travel[gained[: end + 1] <= contacts.begins] = 0.0
    travel /= travel.sum() or 1.0

    def share(of: Bools) -> float:
        return float(travel[of[: end + 1]].sum())

    held, elsewhere = touch.held[episode], touch.elsewhere[episode]
    nothing, other = share(~held & ~elsewhere), share(elsewhere & ~held)
    if not success.any():
        name = "short"
    elif nothing >= at.untouched and nothing >= other:
        name = "flung"
    elif other >= at.elsewhere:
        name = "elsewhere"
    else:
        name = "grasp" if share(touch.opposed[episode]) >= at.grasp else "held"
    return _Told(name, last, nothing)


def _lasting(happens: Bools, gap: int) -> Bools:
    return np.asarray(
        scipy.ndimage.maximum_filter1d(happens.astype(np.uint8), 2 * gap + 1, axis=1), dtype=bool
    )


def _shares(found: Sequence[_Told]) -> dict[str, float]:
    return shares([told.name for told in found], STRATEGIES)


def _by_part(contacts: Contacts, forces: NDArray[np.float32]) -> dict[str, float]:
    held = [contacts.targets.index(name) for name in contacts.held]
    by_part = forces[..., held].sum(axis=(0, 1, 3), dtype=np.float64)
    whole = by_part.sum() or 1.0
    return dict(zip(contacts.parts, (by_part / whole).tolist(), strict=True))


def _quantiles(values: NDArray[np.float64]) -> list[float] | None:
    known = values[np.isfinite(values)]
    return np.quantile(known, QUANTILES).tolist() if known.size else None


def _mean(values: NDArray[np.float64]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def _or_none(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
