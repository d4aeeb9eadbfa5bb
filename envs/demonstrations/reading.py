"""What a reader is, and the one way in which its arrays become episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from envs.demonstrations import limits
from envs.demonstrations.episode import Detail, Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.files import one_line
from envs.demonstrations.findings import Kind, Notes
from envs.demonstrations.schema import DemoSchema
from envs.demonstrations.units import Units
from envs.demonstrations.validation import RawEpisode, build_episode


@dataclass(frozen=True)
class Record:
    """One episode as a reader hands it over.

    Attributes:
        raw: its arrays.
        where: file and place, for messages.
        details: of its provenance.
        provenance: of an episode that knows its own; None is "recorded in this file".
    """

    raw: RawEpisode
    where: str
    details: Mapping[str, Detail] = field(default_factory=dict)
    provenance: Provenance | None = None


@dataclass(frozen=True)
class Reader:
    """One format; a module of `envs.demonstrations.readers` with a ``READER`` is found by itself.

    Attributes:
        form: the format and what it is recognised by, for messages.
        fits: whether a file or folder is of this format. It opens no more than it must, follows no
            link and never raises.
        read: yields the episodes of what fits.
        suffixes: of files that can only be this format's, so that a damaged one is not passed over.
        prefix: of names that are no paths (``minari:``).
        locate: finds, or downloads, what such a name means.
    """

    form: str
    fits: Callable[[Path], bool]
    read: Callable[[Path, DemoSchema, Notes], Iterator[Record]]
    suffixes: tuple[str, ...] = ()
    prefix: str | None = None
    locate: Callable[[str], Path] | None = None


class FileSource:
    """Episodes of one file or folder of one format.

    Args:
        reader: of the format.
        spec: path, or a name that the reader locates.
    """

    def __init__(self, reader: Reader, spec: str | Path) -> None:
        self.reader = reader
        self.spec = spec
        self.name = spec.name if isinstance(spec, Path) else spec

    def load(
        self,
        schema: DemoSchema,
        notes: Notes | None = None,
        refused: list[DemonstrationError] | None = None,
    ) -> list[Episode]:
        """Read every episode and check it against the task's schema.

        Args:
            schema: of the task.
            notes: take down what is dropped, joined or changed on the way.
            refused: collects the errors of single episodes that do not pass, which are then left
                out; None raises the first.

        Raises:
            DemonstrationError: the source is missing, unreadable, unsafe, holds nothing or does not
                fit the task.
        """
        notes = Notes() if notes is None else notes
        episodes: list[Episode] = []
        failed = elements = 0
        units = Units(schema)
        try:
            for index, record in enumerate(self.reader.read(self._path(), schema, notes)):
                elements += _elements(record.raw)
                if elements > limits.MAX_TOTAL_ELEMENTS:
                    raise DemonstrationError(
                        record.where,
                        f"brings the source to {elements:,} numbers",
                        f"At most {limits.MAX_TOTAL_ELEMENTS:,} are read: split it",
                    )
                try:
                    episodes.append(self._episode(index, record, schema, notes))
                    units.see(record.raw)
                except DemonstrationError as error:
                    if refused is None:
                        raise
                    failed += 1
                    notes.add(Kind.REFUSED, 1, error)
                    refused.append(error)
        except DemonstrationError:
            raise
        # Whatever a library says about a damaged file, its reader's user hears it in one line.
        except Exception as error:
            raise DemonstrationError(
                f"{self.spec}, behind episode {len(episodes) + failed}",
                f"cannot be read ({one_line(error)})",
                "It is damaged or of another format: download or record it again",
            ) from error
        if not episodes and not failed:
            raise DemonstrationError(self.spec, "holds no episodes", f"Expected {self.reader.form}")
        units.tell(notes, self.name, failed)
        return episodes

    def _path(self) -> Path:
        if isinstance(self.spec, Path) or self.reader.locate is None:
            return Path(self.spec)
        return self.reader.locate(self.spec)

    def _episode(self, index: int, record: Record, schema: DemoSchema, notes: Notes) -> Episode:
        provenance = record.provenance
        if provenance is None:
            provenance = Provenance(self.name, index, "recorded", record.details)
        return build_episode(record.raw, provenance, record.where, schema, notes)


def _elements(raw: RawEpisode) -> int:
    def count(value: Any) -> int:
        return sum(map(count, value.values())) if isinstance(value, Mapping) else np.size(value)

    return count(raw.observations) + count(raw.actions)
