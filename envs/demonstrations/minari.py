"""Demonstrations in Farama's Minari format: a hub id or a folder on disk."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.validation import RawEpisode, build_episode

_DATA_FILE = Path("data") / "main_data.hdf5"


def is_minari_folder(path: Path) -> bool:
    """Whether ``path`` is the folder of one Minari dataset (HDF5 or Arrow)."""
    return (path / "data" / "metadata.json").is_file() or (path / _DATA_FILE).is_file()


class MinariSource:
    """Episodes of a Minari dataset.

    Observations may be the 38-d or 39-d array. If the recorded infos hold ``qpos``, ``qvel`` and
    ``door_body_pos``, their first entries are the initial state. The environment variable
    ``MINARI_OFFLINE=1`` forbids downloads.

    Args:
        dataset: an id such as ``D4RL/door/human-v2`` (downloaded if this machine lacks it), or
            the folder of a dataset.
    """

    def __init__(self, dataset: str | Path) -> None:
        self.dataset = dataset
        self.name = dataset.name if isinstance(dataset, Path) else f"minari:{dataset}"

    def load(self) -> list[Episode]:
        """Read and check all episodes.

        Raises:
            DemonstrationError: minari is not installed, the dataset cannot be found or read, or it
                does not hold episodes of the door task.
        """
        episodes = [self._episode(data) for data in self._read()]
        if not episodes:
            raise DemonstrationError(self.name, "holds no episodes", "Check the dataset id")
        return episodes

    def _read(self) -> list[Any]:
        try:
            import minari  # noqa: PLC0415 - an extra: most users never need it
        except ImportError as error:
            raise DemonstrationError(
                self.name, "needs the package minari", "pip install 'minari[hdf5]'"
            ) from error
        try:
            if isinstance(self.dataset, Path):
                dataset = minari.MinariDataset(self.dataset / "data")
            else:
                dataset = minari.load_dataset(self.dataset, download=not _offline())
            return list(dataset.iterate_episodes())
        # minari raises whatever its storage, the hub client or the network raise.
        except Exception as error:
            raise DemonstrationError(
                self.name,
                f"cannot be read ({type(error).__name__}: {error})",
                "Check the id with `minari list remote`, download it once with "
                f"`minari download {self.dataset}`, or give the folder of a dataset",
            ) from error

    def _episode(self, data: Any) -> Episode:
        where = f"{self.name}, episode {data.id}"
        if isinstance(data.observations, Mapping | tuple):
            raise DemonstrationError(
                where, "has structured observations", "Only flat 38-d or 39-d arrays are supported"
            )
        raw = RawEpisode(
            observations=data.observations,
            actions=data.actions,
            rewards=data.rewards,
            door_position=_first(data.infos, "door_body_pos"),
            qpos=_first(data.infos, "qpos"),
            qvel=_first(data.infos, "qvel"),
        )
        return build_episode(raw, Provenance(self.name, int(data.id), "recorded"), where)


def _first(infos: Mapping[str, Any] | None, key: str) -> np.ndarray | None:
    if not infos or key not in infos or len(infos[key]) == 0:
        return None
    return np.asarray(infos[key][0])


def _offline() -> bool:
    return os.environ.get("MINARI_OFFLINE", "") not in ("", "0")
