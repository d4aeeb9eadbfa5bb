"""Demonstration multiplication: many successful episodes out of a few (beyond the paper).

A recorded action sequence is replayed faster, from other starts and with noise, and the simulator
says whether it still succeeds. How an episode is varied and played is the task's part
(:class:`Variation`); here is what is tried next, what is kept and for how long. Relatives:
MimicGen (Mandlekar et al., 2023) moves demonstrations to other object poses; DART (Laskey et al.,
2017) executes noise but records the clean action, so that the data holds recoveries.

Deviation: the paper trains on the recorded demonstrations alone (section IV-B). Humans are slow, so
a policy that copies them earns little within the horizon. Off unless a `MultiplyConfig` is given to
`load_demonstrations`.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.episode import Episode, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.readers.recording import read_card, read_recording
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.writers.recording import write_recording
from envs.steps import count_steps, counted_steps

_logger = logging.getLogger(__name__)

#: Part of the cache key. Raise it whenever the same inputs give other episodes.
CODE_VERSION = 2
HASH = "content_hash"
"""Key of a cache file's card."""
_STEPS = "simulator_steps"


class Attempt(Protocol):
    """One variation of one source."""

    @property
    def source(self) -> int:
        """Index of the episode that is varied."""
        ...

    @property
    def speed(self) -> float:
        """Relative to the recording."""
        ...


A = TypeVar("A", bound=Attempt)


class Player(Protocol[A]):
    """Draws variations of given episodes and plays them."""

    def draw(
        self, index: int, weights: NDArray[np.float64], speeds: NDArray[np.float64] | None = None
    ) -> A:
        """Attempt number ``index``, the same for the same index, settings and weights.

        Args:
            index: number of the attempt.
            weights: [sources], not negative: how much each source is wanted.
            speeds: [sources, parts], not negative: how much each of these equal parts of the range
                of speeds is wanted of a source; None is alike.
        """
        ...

    def play(self, attempts: Sequence[A]) -> Iterator[Episode | None]:
        """Plays attempts together; an episode of kind ``multiplied`` for each success, in order."""
        ...


class Variation(Protocol):
    """How a task varies its demonstrations."""

    @property
    def schema(self) -> DemoSchema:
        """Of the episodes."""
        ...

    @property
    def identity(self) -> str:
        """All that the attempts depend on besides episodes and settings: part of a cache's key."""
        ...

    def open(
        self, episodes: Sequence[Episode], settings: MultiplyConfig, num_threads: int | None
    ) -> AbstractContextManager[Player[Any]]:
        """Makes ready to vary ``episodes``.

        Raises:
            DemonstrationError: an episode lacks what varying it needs.
        """
        ...


def multiply(
    episodes: Sequence[Episode],
    config: MultiplyConfig,
    vary: Variation,
    num_threads: int | None = None,
) -> list[Episode]:
    """Make successful episodes from starts of the task's reset distribution.

    Args:
        episodes: re-simulated episodes with their starts. Sources need not succeed within the
            horizon themselves: replayed faster, they may.
        config: what to try and what to keep.
        vary: the task's way to vary them.
        num_threads: threads of the simulator, default all cores. No effect on the result.

    Returns:
        At most ``target_episodes`` episodes of kind ``multiplied``, in the order of their attempts;
        fewer (with a warning) if ``max_attempts`` are used up. Their actions are the clean ones,
        ``executed_actions`` those with noise, both clipped to [-1, 1] as environments do.

    Raises:
        DemonstrationError: an episode lacks what varying it needs, or no attempt succeeds.
    """
    kept: list[Episode] = []
    tally = Tally.empty(len(episodes), config)
    attempts = 0
    tenths = 0
    _logger.info(
        "multiplying %d demonstrations to %d episodes, which can take minutes",
        len(episodes), config.target_episodes,
    )  # fmt: skip
    with vary.open(episodes, config, num_threads) as player:
        while len(kept) < config.target_episodes and attempts < config.max_attempts:
            size = tally.next_round(config.target_episodes - len(kept), config.max_attempts)
            weights, speeds = tally.weights(), tally.speeds()
            batch = [player.draw(attempts + k, weights, speeds) for k in range(size)]
            attempts += size
            for attempt, episode in zip(batch, player.play(batch), strict=True):
                wanted = tally.room_for(attempt.source) and len(kept) < config.target_episodes
                tally.record(attempt, kept=episode is not None and wanted)
                if episode is not None and wanted:
                    kept.append(episode)
            if 10 * len(kept) // config.target_episodes > tenths:
                tenths = 10 * len(kept) // config.target_episodes
                _logger.info(
                    "%d of %d episodes after %d attempts",
                    len(kept),
                    config.target_episodes,
                    attempts,
                )
    if not kept:
        raise DemonstrationError(
            "multiplication",
            f"none of {attempts} attempts {_goal(config)}",
            "Check that the demonstrations succeed (make demos-check)",
        )
    if len(kept) < config.target_episodes:
        _logger.warning(
            "kept %d of %d multiplied episodes in %d attempts; "
            "for more, raise max_attempts or lower min_progress",
            len(kept), config.target_episodes, attempts,
        )  # fmt: skip
    return kept


def multiply_cached(
    episodes: Sequence[Episode],
    config: MultiplyConfig,
    vary: Variation,
    *,
    num_threads: int | None = None,
    cache_dir: str | Path | None = None,
) -> list[Episode]:
    """`multiply`, kept in ``cache_dir`` under a hash of the episodes, the config and the code.

    Args:
        episodes: see `multiply`.
        config: see `multiply`.
        vary: see `multiply`.
        num_threads: see `multiply`.
        cache_dir: folder of the cache; None computes every time.

    Raises:
        DemonstrationError: see `multiply`; a damaged cache file is replaced instead.
    """
    if cache_dir is None:
        return multiply(episodes, config, vary, num_threads)
    path = Path(cache_dir) / f"multiplied-{cache_key(episodes, config, vary)[:24]}.h5"
    if path.is_file():
        try:
            kept, steps_taken = _cached(path, vary.schema)
            count_steps(steps_taken)
            return kept
        except DemonstrationError as error:
            _logger.warning("replacing a damaged cache file: %s", error)
        except KeyError:
            _logger.info("%s does not say how many steps it took: making it again", path)
    with counted_steps() as steps:
        result = multiply(episodes, config, vary, num_threads)
    card = {
        "made_by": "multiply",
        "config": dataclasses.asdict(config),
        "version": CODE_VERSION,
        HASH: content_hash(result),
        _STEPS: steps.taken,
    }
    write_recording(path, result, card)
    return result


def _cached(path: Path, schema: DemoSchema) -> tuple[list[Episode], int]:
    """The episodes of a cache file, if they are those that were written, and what they cost."""
    kept, card = read_recording(path, schema), read_card(path)
    found = content_hash(kept)
    if card.get(HASH, found) != found:  # files of before have none
        raise DemonstrationError(path, "is not as it was written (another hash)", "It can go")
    return kept, int(card[_STEPS])


def cache_key(episodes: Sequence[Episode], config: MultiplyConfig, vary: Variation) -> str:
    """SHA-256 (hex) of everything that the result of `multiply` depends on."""
    settings = json.dumps(dataclasses.asdict(config), sort_keys=True)
    parts = f"{CODE_VERSION} {vary.identity} {content_hash(episodes)} {settings}"
    return sha256(parts.encode()).hexdigest()


def _goal(config: MultiplyConfig) -> str:
    if config.min_progress is None:
        return "succeeded"
    return f"got beyond a progress of {config.min_progress}"


@dataclass
class Tally:
    """Attempts and kept episodes, and what follows for the next round.

    Attributes:
        tried: [sources, parts of the range of speeds].
        kept: likewise.
        cap: episodes that a source gives at most.
        config: what is tried.
    """

    tried: NDArray[np.int64]
    kept: NDArray[np.int64]
    cap: int
    config: MultiplyConfig

    @classmethod
    def empty(cls, sources: int, config: MultiplyConfig) -> Tally:
        """Of nothing tried yet.

        Raises:
            DemonstrationError: there are no sources.
        """
        if sources == 0:
            raise DemonstrationError("multiplication", "got no episodes", "Check the source")
        cap = int(np.ceil(config.balance * config.target_episodes / sources))
        zeros = np.zeros((sources, config.speed_bins), dtype=np.int64)
        return cls(zeros, zeros.copy(), cap, config)

    def room_for(self, source: int) -> bool:
        """Whether another episode of a source would be kept."""
        return bool(self.kept[source].sum() < self.cap)

    def record(self, attempt: Attempt, *, kept: bool) -> None:
        """Notes one attempt."""
        at = attempt.source, self._part(attempt.speed)
        self.tried[at] += 1
        self.kept[at] += kept

    def weights(self) -> NDArray[np.float64]:
        """Weight [sources]: what is still missing, times how often the source succeeds."""
        missing = (self.cap - self.kept.sum(axis=1)) / self.cap
        return np.asarray(missing * self._success())

    def speeds(self) -> NDArray[np.float64]:
        """Weight [sources, parts]: the square of how often the source succeeds there.

        A part that was hardly tried is taken for the average of its source. To only succeed, the
        best part alone would do; a policy is to see all speeds.
        """
        average = self._success()[:, None]
        found = (self.kept + _AS_MANY * average) / (self.tried + _AS_MANY)
        return np.asarray(found**2)

    def next_round(self, missing: int, max_attempts: int) -> int:
        """Attempts to make next: about as many as the missing episodes will need."""
        success = (self.kept.sum() + 1.0) / (self.tried.sum() + 2.0)
        needed = int(np.ceil(missing / success))
        return max(1, min(self.config.round_size, needed, max_attempts - int(self.tried.sum())))

    def _success(self) -> NDArray[np.float64]:
        # Laplace's estimate starts at 1/2, so that every source is tried before it is judged.
        return np.asarray((self.kept.sum(axis=1) + 1.0) / (self.tried.sum(axis=1) + 2.0))

    def _part(self, speed: float) -> int:
        low, high = self.config.speed_low, self.config.speed_high
        share = 0.0 if low == high else (speed - low) / (high - low)
        return min(int(share * self.config.speed_bins), self.config.speed_bins - 1)


_AS_MANY = 2.0
"""Attempts that the average of a source stands for in each part of its speeds."""
