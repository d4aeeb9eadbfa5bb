"""Farama's Minari datasets: a hub id or a folder on disk."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from gymnasium import spaces

from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import (
    one_line,
    open_hdf5,
    read_json_file,
    require_hdf5_elements,
    require_regular,
)
from envs.demonstrations.findings import Notes
from envs.demonstrations.flattening import named_columns
from envs.demonstrations.reading import Reader, Record
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.validation import RawEpisode, found_start
from envs.flatten import Flattener

PREFIX: Final = "minari:"
_DATA: Final = "data"
_METADATA: Final = "metadata.json"
_HDF5: Final = "main_data.hdf5"
_SUCCESS: Final = ("success", "is_success")


def read(path: Path, schema: DemoSchema, notes: Notes) -> Iterator[Record]:
    """Episodes of the dataset in the folder ``path``.

    Structured observations are flattened, discrete ones become one-hot. Where the recorded infos
    hold vectors of the schema's ``start``, their first entries say where an episode begins;
    ``success`` and ``progress`` are read from there too.
    """
    name = str(path)
    minari = require_minari(name)
    _inspect(path)
    try:
        dataset = minari.MinariDataset(path / _DATA)
        space = dataset.observation_space
        for data in dataset.iterate_episodes():
            yield Record(_raw(data, space, schema), f"{path.name}, episode {data.id}")
    except DemonstrationError:
        raise
    # minari raises whatever its storage and its parsers of spaces raise.
    except Exception as error:
        raise DemonstrationError(
            name, f"cannot be read ({one_line(error)})", "Download the dataset again"
        ) from error


def locate(spec: str) -> Path:
    """Folder of the dataset ``minari:ID``, downloaded if this machine lacks it.

    The environment variable ``MINARI_OFFLINE=1`` forbids downloads.

    Raises:
        DemonstrationError: minari is not installed, or the dataset cannot be had.
    """
    dataset = spec.removeprefix(PREFIX)
    minari = require_minari(spec)
    try:
        path = Path(minari.storage.get_dataset_path(dataset))
        if not is_dataset(path):
            if os.environ.get("MINARI_OFFLINE", "") not in ("", "0"):
                raise FileNotFoundError(f"not on this machine ({path}), and MINARI_OFFLINE is set")
            minari.download_dataset(dataset)
    # Whatever the hub's client, the network or the parser of ids raise.
    except Exception as error:
        raise DemonstrationError(
            spec,
            f"cannot be had ({one_line(error)})",
            "Check the id with `minari list remote`, download it once with "
            f"`minari download {dataset}`, or give the folder of a dataset",
        ) from error
    return path


def require_minari(name: str) -> Any:
    """The package minari.

    Raises:
        DemonstrationError: it is not installed.
    """
    try:
        import minari  # noqa: PLC0415 - an extra: most users never need it
    except ImportError as error:
        raise DemonstrationError(
            name, f"needs the package minari ({error})", "pip install 'bc-sac[minari]'"
        ) from error
    return minari


def is_dataset(path: Path) -> bool:
    """Whether ``path`` is the folder of one Minari dataset (HDF5 or Arrow)."""
    return (path / _DATA / _METADATA).is_file() or (path / _DATA / _HDF5).is_file()


def _inspect(path: Path) -> None:
    """Look at every file before minari, which follows links and allocates what a header says."""
    for file in sorted((path / _DATA).glob("**/*")):
        if not file.is_dir():
            require_regular(file)
    metadata = path / _DATA / _METADATA
    if metadata.is_file():
        read_json_file(metadata, "description")
    if (path / _DATA / _HDF5).exists():
        with open_hdf5(path / _DATA / _HDF5) as file:
            require_hdf5_elements(file, str(path))


def _raw(data: Any, space: spaces.Space[Any], schema: DemoSchema) -> RawEpisode:
    infos = named_columns(data.infos) if data.infos else {}
    series = {key: value for key, value in infos.items() if value.ndim > 0 and len(value)}
    success = next((series[key] for key in _SUCCESS if key in series), None)
    return RawEpisode(
        observations=_encoded(data.observations, space),
        actions=data.actions,
        rewards=data.rewards,
        terminated=data.terminations,
        start=found_start({key: value[0] for key, value in series.items()}, schema),
        success=success,
        progress=series.get("progress"),
    )


def _encoded(value: Any, space: spaces.Space[Any]) -> Any:
    """Observations with discrete entries one-hot, also where the schema does not name them."""
    if isinstance(space, spaces.Dict):
        return {key: _encoded(value[key], inner) for key, inner in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return {str(i): _encoded(value[i], inner) for i, inner in enumerate(space.spaces)}
    if isinstance(space, spaces.Discrete | spaces.MultiDiscrete):
        return Flattener.of(space)(value)
    return value


READER = Reader(
    form="minari:ID, or the folder of a Minari dataset",
    fits=is_dataset,
    read=read,
    prefix=PREFIX,
    locate=locate,
)
