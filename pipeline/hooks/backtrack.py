"""Return to a policy that worked when training episodes begin to fail."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Collection, Sequence
from copy import deepcopy
from dataclasses import dataclass
from statistics import median
from typing import Any

import scipy  # `stats` takes half a second to load, and scipy does it where it is first used
from pydantic.dataclasses import dataclass as settings
from torch import nn
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.episodes import FinishedEpisode
from pipeline.settings import STRICT, Count, Share

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Verdict:
    """What a window of training episodes is beside those before it.

    Attributes:
        chance: of as bad a window if nothing has changed, in [0, 1]; 1 without any before it.
        usual: whether it is at least as good as what is usual.
        seen: in words.
    """

    chance: float
    usual: bool
    seen: str


def by_success(window: Collection[float], usual: Collection[float]) -> Verdict:
    """Judge by successes, 1 or 0 an episode: a one-sided binomial test.

    Args:
        window: W episodes.
        usual: those before them.
    """
    successes, episodes = int(sum(window)), len(window)
    # Laplace's rule: after nothing but successes, one failure is still possible.
    rate = (sum(usual) + 1) / (len(usual) + 2)
    chance = (
        scipy.stats.binomtest(successes, episodes, rate, alternative="less").pvalue
        if usual
        else 1.0
    )
    return Verdict(
        float(chance),
        successes >= rate * episodes,
        f"{successes} of {episodes} training episodes succeeded",
    )


def by_return(window: Collection[float], usual: Collection[float]) -> Verdict:
    """Judge by returns, whatever their scale and shape: a one-sided rank test (Mann-Whitney).

    Args:
        window: W episodes.
        usual: those before them.
    """
    own, before = list(window), list(usual)
    # Where all returns are one number, the test has nothing to rank and gives no number.
    flat = len({*own, *before}) == 1
    chance = (
        1.0
        if flat or not before
        else scipy.stats.mannwhitneyu(own, before, alternative="less").pvalue
    )
    middle = median(own)
    return Verdict(
        float(chance),
        not before or middle >= median(before),
        f"half of {len(own)} training episodes returned less than {middle:.4g}",
    )


@settings(frozen=True, kw_only=True, config=STRICT)
class BacktrackSettings:
    """Return to the last good policy when training episodes begin to fail."""

    level: Share | None = None  # of the test for it, in (0, 1); None = never go back
    window: Count = 10  # episodes that are judged together
    memory: Count = 100  # episodes before them that say what is usual


class BacktrackHook(TrainerHookBase):
    """Takes the actor back to its last good weights once it fails more often than chance explains.

    An actor that gets faster goes over a cliff now and then: the critics, who have not seen what
    is beyond, follow some thousand frames later. Every ``window`` training episodes are compared
    with the ``memory`` before them, by a one-sided test: of their successes, or of their returns
    where the task tells no success. Too few or too low, and the actor gets back the weights with
    which the last window of at least the usual began; critics and buffers keep what they learned
    from the failures. Failures count as usual too, so a policy that cannot do better is not held
    back for ever. Only training episodes are looked at, never an evaluation. TD7 also judges and
    keeps policies by whole training episodes (Fujimoto et al., 2023, arXiv:2306.02451).

    Deviation: the paper never takes an update back; ``backtrack.level=null`` does not either.

    Args:
        modules: What goes back together: the actor and, if there is one, its average.
        level: Of the test, in (0, 1): about the largest chance, per window, of going back although
            nothing has changed.
        window: Episodes that are judged together.
        memory: Episodes before them that say what is usual.

    Raises:
        ValueError: If one of them is out of range.
    """

    def __init__(
        self, modules: Sequence[nn.Module], level: float, *, window: int, memory: int
    ) -> None:
        if not 0.0 < level < 1.0:
            raise ValueError(f"backtrack.level must be in (0, 1) or null, got {level}.")
        if not 1 <= window <= memory:
            raise ValueError(
                "backtrack.window must be at least 1 and at most backtrack.memory, "
                f"got {window} and {memory}."
            )
        self.modules = list(modules)
        self.level = level
        self.window: deque[float] = deque(maxlen=window)
        self.usual: deque[float] = deque(maxlen=memory)
        self.count = 0
        self._candidate = self._weights()
        self._good = self._candidate

    def __call__(self, episode: FinishedEpisode, frame: int) -> None:
        """Takes one finished training episode; goes back at most once per window."""
        told = episode.success is not None
        self.window.append(float(bool(episode.success)) if told else episode.episode_return)
        if len(self.window) < (self.window.maxlen or 0):
            return
        verdict = (by_success if told else by_return)(self.window, self.usual)
        if verdict.chance < self.level:
            self._go_back(f"{verdict.seen} at {frame} frames")
        elif verdict.usual:
            self._good = self._candidate
        self.usual.extend(self.window)
        self.window.clear()
        self._candidate = self._weights()

    def _go_back(self, seen: str) -> None:
        for module, weights in zip(self.modules, self._good, strict=True):
            module.load_state_dict(weights)
        self.count += 1
        _logger.info("back to the last good policy: %s", seen)

    def _weights(self) -> list[dict[str, Any]]:
        return [deepcopy(module.state_dict()) for module in self.modules]

    def counted(self) -> dict[str, float]:
        """How often the actor was taken back, for the learning curve."""
        return {"backtracks": float(self.count)}

    def register(self, trainer: Trainer, name: str = "backtrack") -> None:
        """Registers for the checkpoint only; episodes come from ``EpisodeHook``."""
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """The windows, and both sets of weights by the module's place."""
        return {
            "window": list(self.window),
            "usual": list(self.usual),
            "count": self.count,
            "candidate": _numbered(self._candidate),
            "good": _numbered(self._good),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.window = deque(state["window"], maxlen=self.window.maxlen)
        self.usual = deque(state["usual"], maxlen=self.usual.maxlen)
        self.count = state["count"]
        self._candidate = [state["candidate"][str(i)] for i in range(len(self.modules))]
        self._good = [state["good"][str(i)] for i in range(len(self.modules))]


def _numbered(weights: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {str(i): entry for i, entry in enumerate(weights)}
