"""Demonstration multiplication: many successful episodes out of a few (beyond the paper).

A recorded action sequence is replayed faster, from other starts and with noise, and the simulator
says whether it still succeeds. How an episode is varied and played is the task's part
(:class:`Variation`), what is tried next the :class:`Tally`'s; here is what is kept. Relatives:
MimicGen (Mandlekar et al., 2023) moves demonstrations to other object poses; DART (Laskey et al.,
2017) executes noise but records the clean action, so that the data holds recoveries.

Deviation: the paper trains on the recorded demonstrations alone (section IV-B). Humans are slow, so
a policy that copies them earns little within the horizon. Off unless a `MultiplyConfig` is given to
`load_demonstrations`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.tally import Tally
from envs.demonstrations.variation import Player, Variation

_logger = logging.getLogger(__name__)


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
    tally = Tally.empty(len(episodes), config)
    _logger.info(
        "multiplying %d demonstrations to %d episodes, which can take minutes",
        len(episodes), config.target_episodes,
    )  # fmt: skip
    with vary.open(episodes, config, num_threads) as player:
        kept = _play_rounds(player, tally, config)
    attempts = int(tally.tried.sum())
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


def _play_rounds(player: Player[Any], tally: Tally, config: MultiplyConfig) -> list[Episode]:
    """What is kept, until it is enough or the attempts are used up; all are noted in ``tally``."""
    kept: list[Episode] = []
    attempts = 0
    tenths = 0
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
                len(kept), config.target_episodes, attempts,
            )  # fmt: skip
    return kept


def _goal(config: MultiplyConfig) -> str:
    if config.min_progress is None:
        return "succeeded"
    return f"got beyond a progress of {config.min_progress}"
