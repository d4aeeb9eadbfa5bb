"""One way to open demonstrations, whatever format they are in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from envs.demonstrations.dapg import DapgSource
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.hdf5 import Hdf5Source
from envs.demonstrations.minari import MinariSource, is_minari_folder
from envs.demonstrations.recording import read_recording

#: The recordings that come with the package; see the card beside them.
BUNDLED = Path(__file__).parent / "bundled" / "door_bc.h5"
MINARI_PREFIX = "minari:"
_FORMS = "Use bundled, minari:ID, a .pickle/.pkl or .h5/.hdf5 file, or a folder of these"


class DemonstrationSource(Protocol):
    """Something that episodes can be loaded from."""

    name: str

    def load(self) -> list[Episode]:
        """Read and validate every episode.

        Raises:
            DemonstrationError: the source is missing, unreadable, unsafe or does not fit the task.
        """
        ...


class RecordingSource:
    """A recording written by `envs.demonstrations.recording.write_recording`.

    Args:
        path: the file.
        name: how provenance and reports call it, default the file's name.
    """

    def __init__(self, path: str | Path, name: str | None = None) -> None:
        self.path = Path(path)
        self.name = name or self.path.name

    def load(self) -> list[Episode]:
        """See `DemonstrationSource.load`."""
        return read_recording(self.path)


class FolderSource:
    """Every demonstration file of one folder, in the order of their names.

    Args:
        path: folder with ``.h5``, ``.hdf5``, ``.pickle`` or ``.pkl`` files.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name

    def load(self) -> list[Episode]:
        """See `DemonstrationSource.load`."""
        files = sorted(file for file in self.path.iterdir() if file.suffix.lower() in _BY_SUFFIX)
        if not files:
            raise DemonstrationError(self.path, "holds no demonstration files", _FORMS)
        return [episode for file in files for episode in open_source(str(file)).load()]


_BY_SUFFIX: dict[str, Callable[[Path], DemonstrationSource]] = {
    ".pickle": DapgSource,
    ".pkl": DapgSource,
    ".h5": Hdf5Source,
    ".hdf5": Hdf5Source,
}


def open_source(spec: str | Path) -> DemonstrationSource:
    """Find the reader for a source; nothing is read until its `load` is called.

    Args:
        spec: ``bundled``, ``minari:ID``, a ``.pickle``/``.pkl`` or ``.h5``/``.hdf5`` file, the
            folder of a Minari dataset, or a folder of demonstration files.

    Raises:
        DemonstrationError: no such file or folder, or no reader for its kind.
    """
    text = str(spec)
    if text == "bundled":
        return RecordingSource(BUNDLED, name="bundled")
    if text.startswith(MINARI_PREFIX):
        return MinariSource(text.removeprefix(MINARI_PREFIX))
    path = Path(text).expanduser()
    if not path.exists():
        raise DemonstrationError(path, "does not exist", _FORMS)
    if path.is_dir():
        return MinariSource(path) if is_minari_folder(path) else FolderSource(path)
    reader = _BY_SUFFIX.get(path.suffix.lower())
    if reader is None:
        raise DemonstrationError(path, f"has the unknown suffix {path.suffix!r}", _FORMS)
    return reader(path)
