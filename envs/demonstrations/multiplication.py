"""Demonstration multiplication: many successful episodes out of a few (beyond the paper).

A recorded action sequence is replayed faster, at other doors and with noise, and the simulator says
whether the door still opens. Relatives: MimicGen (Mandlekar et al., 2023) moves demonstrations to
other object poses; DART (Laskey et al., 2017) executes noise but records the clean action, so that
the data holds recoveries.

Deviation: the paper trains on the recorded demonstrations alone (section IV-B). Humans need 144-219
steps to move the door, of an episode of 200, so a policy that copies them earns little. Off unless
a `MultiplyConfig` is given to `load_demonstrations`.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envs.demonstrations.attempts import Attempt, AttemptFactory, play_attempts
from envs.demonstrations.episode import Episode, Provenance, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.recording import read_recording, write_recording
from envs.door import task
from envs.door.simulator import DoorSimulator

_logger = logging.getLogger(__name__)

#: Part of the cache key. Raise it whenever the same inputs give other episodes.
CODE_VERSION = 1


def multiply(
    episodes: Sequence[Episode], config: MultiplyConfig, num_threads: int | None = None
) -> list[Episode]:
    """Make successful episodes at doors of the task's reset distribution.

    Args:
        episodes: re-simulated episodes with their door positions. Sources need not succeed within
            the horizon themselves: replayed faster, they may.
        config: what to try and what to keep.
        num_threads: threads of the simulator, default all cores. No effect on the result.

    Returns:
        At most ``target_episodes`` episodes of kind ``multiplied``, in the order of their attempts;
        fewer (with a warning) if ``max_attempts`` are used up. Their actions are the clean ones,
        already clipped to [-1, 1].

    Raises:
        DemonstrationError: an episode has no door position, or no attempt succeeds.
    """
    kept: list[Episode] = []
    tally = _Tally.empty(len(episodes), config)
    attempts = 0
    tenths = 0
    _logger.info(
        "multiplying %d demonstrations to %d episodes, which can take minutes",
        len(episodes), config.target_episodes,
    )  # fmt: skip
    with DoorSimulator(config.round_size, num_threads=num_threads) as simulator:
        factory = AttemptFactory.prepare(episodes, config, simulator.scene)
        while len(kept) < config.target_episodes and attempts < config.max_attempts:
            size = tally.next_round(config.target_episodes - len(kept), config.max_attempts)
            weights = tally.weights()
            batch = [factory.draw(attempts + k, weights) for k in range(size)]
            attempts += size
            for attempt, observations in play_attempts(simulator, batch, config):
                wanted = tally.room_for(attempt.source) and len(kept) < config.target_episodes
                success = observations is not None
                tally.record(attempt.source, tried=True, kept=success and wanted)
                if observations is not None and wanted:
                    kept.append(_episode(episodes[attempt.source], attempt, observations))
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
            f"none of {attempts} attempts passed {config.min_angle} rad",
            "Check that the demonstrations open the door (make demos-check)",
        )
    if len(kept) < config.target_episodes:
        _logger.warning(
            "kept %d of %d multiplied episodes in %d attempts; "
            "for more, raise max_attempts or lower min_angle",
            len(kept), config.target_episodes, attempts,
        )  # fmt: skip
    return kept


def multiply_cached(
    episodes: Sequence[Episode],
    config: MultiplyConfig,
    *,
    num_threads: int | None = None,
    cache_dir: str | Path | None = None,
) -> list[Episode]:
    """`multiply`, kept in ``cache_dir`` under a hash of the episodes, the config and the code.

    Args:
        episodes: see `multiply`.
        config: see `multiply`.
        num_threads: see `multiply`.
        cache_dir: folder of the cache; None computes every time.

    Raises:
        DemonstrationError: see `multiply`; a damaged cache file is replaced instead.
    """
    if cache_dir is None:
        return multiply(episodes, config, num_threads)
    path = Path(cache_dir) / f"multiplied-{cache_key(episodes, config)[:24]}.h5"
    if path.is_file():
        try:
            return read_recording(path)
        except DemonstrationError as error:
            _logger.warning("replacing a damaged cache file: %s", error)
    result = multiply(episodes, config, num_threads)
    card = {"made_by": "multiply", "config": dataclasses.asdict(config), "version": CODE_VERSION}
    write_recording(path, result, card)
    return result


def cache_key(episodes: Sequence[Episode], config: MultiplyConfig) -> str:
    """SHA-256 (hex) of everything that the result of `multiply` depends on."""
    settings = json.dumps(dataclasses.asdict(config), sort_keys=True)
    return sha256(f"{CODE_VERSION} {content_hash(episodes)} {settings}".encode()).hexdigest()


@dataclass
class _Tally:
    """Attempts and kept episodes per source, and what follows for the next round."""

    tried: NDArray[np.int64]
    kept: NDArray[np.int64]
    cap: int
    round_size: int

    @classmethod
    def empty(cls, sources: int, config: MultiplyConfig) -> _Tally:
        if sources == 0:
            raise DemonstrationError("multiplication", "got no episodes", "Check the source")
        cap = int(np.ceil(config.balance * config.target_episodes / sources))
        zeros = np.zeros(sources, dtype=np.int64)
        return cls(zeros, zeros.copy(), cap, config.round_size)

    def room_for(self, source: int) -> bool:
        return bool(self.kept[source] < self.cap)

    def record(self, source: int, *, tried: bool, kept: bool) -> None:
        self.tried[source] += tried
        self.kept[source] += kept

    def weights(self) -> NDArray[np.float64]:
        """Weight [sources]: what is still missing, times how often the source succeeds."""
        # Laplace's estimate starts at 1/2, so that every source is tried before it is judged.
        success = (self.kept + 1.0) / (self.tried + 2.0)
        return (self.cap - self.kept) / self.cap * success

    def next_round(self, missing: int, max_attempts: int) -> int:
        """Attempts to make next: about as many as the missing episodes will need."""
        success = (self.kept.sum() + 1.0) / (self.tried.sum() + 2.0)
        needed = int(np.ceil(missing / success))
        return max(1, min(self.round_size, needed, max_attempts - int(self.tried.sum())))


def _episode(source: Episode, attempt: Attempt, observations: NDArray[np.float32]) -> Episode:
    origin = source.provenance
    details = {
        "attempt": attempt.index,
        "speed": attempt.speed,
        "noise_scale": attempt.noise_scale,
        "door_offset_m": attempt.door_offset,
    }
    steps = len(observations) - 1
    return Episode(
        observations=observations,
        actions=attempt.clean_actions[:steps].astype(np.float32),
        rewards=task.reward(observations[1:]),
        terminated=task.terminated(observations[1:]),
        provenance=Provenance(origin.source, origin.episode, "multiplied", details),
        door_position=attempt.door_position,
    )
