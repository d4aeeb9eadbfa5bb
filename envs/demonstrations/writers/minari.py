"""Minari datasets, by minari itself."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import one_line
from envs.demonstrations.matrices import in_file_units
from envs.demonstrations.readers.minari import PREFIX, require_minari
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.writing import Writer


def write_minari(
    out: str,
    episodes: Sequence[Episode],
    card: Mapping[str, Any],
    schema: DemoSchema | None = None,
) -> None:
    """Write a local Minari dataset, which `minari.load_dataset` then opens.

    Infos hold, at every step, ``success`` and ``progress`` where known and the vectors of
    ``start``. The card becomes the dataset's description.

    Args:
        out: ``minari:ID``, such as ``minari:door/mine-v0``.
        episodes: at least one.
        card: JSON-serialisable facts about how they were made.
        schema: of the task, for the units of actions.

    Raises:
        DemonstrationError: minari is not installed, or refuses the id or the data.
    """
    minari = require_minari(out)
    infinite = np.full(episodes[0].observations.shape[1], np.inf, dtype=np.float32)
    actions = [in_file_units(episode.actions, schema) for episode in episodes]
    # Recorded actions may lie beyond the task's bounds, which environments clip.
    bound = max(float(np.abs(taken).max()) for taken in actions)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on authors, permalinks and environments that it misses
        try:
            minari.create_dataset_from_buffers(
                out.removeprefix(PREFIX),
                buffer=[_buffer(minari, *pair) for pair in zip(episodes, actions, strict=True)],
                observation_space=Box(-infinite, infinite, dtype=np.float32),
                action_space=Box(
                    -bound - 1.0, bound + 1.0, episodes[0].actions.shape[1:], np.float32
                ),
                description=json.dumps(dict(card), sort_keys=True),
            )
        # minari raises whatever its storage and its parser of ids raise.
        except Exception as error:
            raise DemonstrationError(
                out,
                f"cannot be written ({one_line(error)})",
                "Choose another id (NAME-v0), or remove the old one with `minari delete`",
            ) from error


def _buffer(minari: Any, episode: Episode, actions: NDArray[np.float32]) -> Any:
    rows = len(episode.observations)
    infos: dict[str, Any] = {
        name: np.tile(vector, (rows, 1)) for name, vector in episode.start.items()
    }
    known = {"success": episode.success, "progress": episode.progress}
    infos |= {key: column for key, column in known.items() if column is not None}
    last = np.arange(episode.length) == episode.length - 1
    return minari.data_collector.EpisodeBuffer(
        observations=episode.observations,
        actions=actions,
        rewards=episode.rewards,
        terminations=episode.terminated,
        truncations=last & ~episode.terminated,
        infos=infos or None,
    )


WRITER = Writer(
    form=f"{PREFIX}ID (a Minari dataset)",
    fits=lambda out: out.startswith(PREFIX),
    write=write_minari,
    ready=require_minari,
)
