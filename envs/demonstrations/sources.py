"""One way to open demonstrations, whatever format they are in."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import open_hdf5, require_regular
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.readers import find_readers
from envs.demonstrations.readers.hdf5_layout import HDF5_SUFFIXES, is_hdf5
from envs.demonstrations.reading import FileSource, Reader
from envs.demonstrations.schema import DemoSchema

BUNDLED = "bundled"
FORMS_PAGE = "What can be named: docs/reference/demonstrations.md"


class DemonstrationSource(Protocol):
    """Something that episodes can be loaded from."""

    name: str

    def load(
        self,
        schema: DemoSchema,
        notes: Notes | None = None,
        refused: list[DemonstrationError] | None = None,
    ) -> list[Episode]:
        """See `envs.demonstrations.reading.FileSource.load`."""
        ...


class BundledSource:
    """The recordings that come with a task."""

    name = BUNDLED

    def load(
        self,
        schema: DemoSchema,
        notes: Notes | None = None,
        refused: list[DemonstrationError] | None = None,
    ) -> list[Episode]:
        """See `DemonstrationSource.load`."""
        if schema.bundled is None:
            raise DemonstrationError(
                "demos.source=bundled",
                f"is not there: no demonstrations come with {schema.describes}",
                "Name your own: DEMOS=path, or DEMOS=minari:ID",
            )
        return open_source(schema.bundled).load(schema, notes, refused)


class FolderSource:
    """Every demonstration file or dataset of one folder, in the order of their names.

    Args:
        path: folder of anything that a reader fits.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name

    def load(
        self,
        schema: DemoSchema,
        notes: Notes | None = None,
        refused: list[DemonstrationError] | None = None,
    ) -> list[Episode]:
        """See `DemonstrationSource.load`. Files that no reader knows are counted and left alone."""
        notes = Notes() if notes is None else notes
        found = sorted(entry for entry in self.path.iterdir() if not entry.name.startswith("."))
        known = [entry for entry in found if _reader_of(entry) or _claimed(entry)]
        for entry in found:
            if entry not in known:
                notes.add(Kind.IGNORED_FILES, 1, entry)
        if not known:
            raise DemonstrationError(self.path, "holds no demonstration files", forms())
        return [e for entry in known for e in open_source(entry).load(schema, notes, refused)]


def open_source(spec: str | Path) -> DemonstrationSource:
    """Find the reader for a source; no episode is read until its `load` is called.

    Args:
        spec: ``bundled``, ``minari:ID``, a file or dataset folder that a reader of
            `envs.demonstrations.readers` fits, or a folder of these.

    Raises:
        DemonstrationError: no such file or folder, or no reader for its kind.
    """
    text = str(spec)
    if text == BUNDLED:
        return BundledSource()
    for reader in find_readers():
        if reader.prefix is not None and text.startswith(reader.prefix):
            return FileSource(reader, text)
    path = Path(text).expanduser()
    if not path.exists():
        where = path.absolute().parent
        raise DemonstrationError(path, f"does not exist (looked for in {where})", FORMS_PAGE)
    if not path.is_dir():
        require_regular(path)
    found = _reader_of(path)
    if found is not None:
        return FileSource(found, path)
    if path.is_dir():
        return FolderSource(path)
    raise _unknown(path)


def forms() -> str:
    """What can be opened, for messages."""
    known = "; ".join(reader.form for reader in find_readers())
    return f"Use {BUNDLED}, {known}; or a folder of these"


def _reader_of(path: Path) -> Reader | None:
    if not (path.is_file() or path.is_dir()):
        return None  # looking into a FIFO waits for its writer
    return next((reader for reader in find_readers() if reader.fits(path)), None)


def _claimed(path: Path) -> bool:
    """Whether a name says that this is a demonstration file, so that damage must not hide it."""
    suffixes = {suffix for reader in find_readers() for suffix in reader.suffixes}
    return not path.is_dir() and (
        is_hdf5(path) or path.suffix.lower() in {*suffixes, *HDF5_SUFFIXES}
    )


def _unknown(path: Path) -> DemonstrationError:
    if is_hdf5(path):
        with open_hdf5(path) as file:  # says what is wrong with it, if anything is
            found = ", ".join(sorted(file)) or "nothing"
        return DemonstrationError(path, f"holds {found}, a layout that nobody knows", forms())
    return DemonstrationError(path, f"has the unknown suffix {path.suffix!r}", forms())
