"""Multiplied episodes on disk: what was made once is read again."""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from envs.demonstrations.episode import Episode, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.multiplication import multiply
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.readers.recording import read_card, read_recording
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.variation import Variation
from envs.demonstrations.writers.recording import write_recording
from envs.steps import count_steps, counted_steps

_logger = logging.getLogger(__name__)

#: Part of the cache key. Raise it whenever the same inputs give other episodes.
CODE_VERSION = 2
HASH = "content_hash"
"""Key of a cache file's card."""
_STEPS = "simulator_steps"


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
