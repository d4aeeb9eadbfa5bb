"""Sources of batch rows that stand in a user's own file (``sampler.own_sources``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

import torch
from pydantic import AfterValidator
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from pipeline.data.demonstrations import Demonstrations
from pipeline.data.rows import FILLED
from pipeline.own_parts import Entry, OwnParts

SOURCES: Final = OwnParts("sampler.own_sources", "source", given=1)
OwnSourceEntry = Annotated[Entry, AfterValidator(SOURCES.checked)]


@dataclass(frozen=True)
class SourceContext:
    """What a source of a user is made with, and can draw from.

    Attributes:
        main: Buffer of the run's own experience, which is still empty when the source is made.
            Where its rows lie by age says :func:`~pipeline.data.buffers.newest`.
        demonstrations: The given ones (``rows`` [R], ``episodes``); None where the run uses none.
        keys: Entries of every row.
        device: Of the batches.
    """

    main: TensorDictReplayBuffer
    demonstrations: Demonstrations | None
    keys: tuple[NestedKey, ...]
    device: torch.device


class OwnSource:
    """A source of a user, of which every row is looked at.

    Args:
        entry: Of the configuration.
        context: What it is made with.

    Raises:
        ValueError: It cannot be made, or does not say ``rows``, ``is_demo`` and how to ``sample``.
    """

    def __init__(self, entry: Entry, context: SourceContext) -> None:
        self.entry = entry
        self.context = context
        self.source: Any = SOURCES.make(entry, context)
        self.rows: int = getattr(self.source, "rows", 0)
        self.is_demo: bool = getattr(self.source, "is_demo", None)  # type: ignore[assignment]  # checked below
        if isinstance(self.rows, bool) or not isinstance(self.rows, int) or self.rows < 1:
            raise SOURCES.refused(entry, f"must say rows, its number in each batch: {self.rows!r}")
        if not isinstance(self.is_demo, bool):
            raise SOURCES.refused(
                entry, "must say is_demo, whether its rows count as demonstrations: True or False"
            )
        if not callable(getattr(self.source, "sample", None)):
            raise SOURCES.refused(entry, "must have sample(count), which gives its rows [count]")

    @property
    def keeps_state(self) -> bool:
        """Whether it has a state to save."""
        return all(callable(getattr(self.source, f"{x}state_dict", None)) for x in ("", "load_"))

    def sample(self, count: int, /) -> TensorDictBase:
        """Rows ``[count]`` with the entries of all rows; further ones are left out.

        Raises:
            ValueError: It gives another number of rows, or an entry is missing or of another form.
        """
        rows = self.source.sample(count)
        if not isinstance(rows, TensorDictBase) or rows.batch_size != (count,):
            given = list(rows.batch_size) if isinstance(rows, TensorDictBase) else type(rows)
            raise SOURCES.refused(self.entry, f"gave {given} for {count} rows; expected [{count}]")
        others = self.context.main[:1]
        for key in self.context.keys:
            found, expected = (_form(one.get(key, None)) for one in (rows, others))
            if found != expected:
                raise SOURCES.refused(
                    self.entry, f"gave rows with {key!r} {found}; expected {expected}"
                )
        kept = [key for key in FILLED if key in rows.keys()]  # noqa: SIM118
        return rows.select(*self.context.keys, *kept).to(self.context.device)


def own_sources(entries: Sequence[Entry], context: SourceContext) -> dict[str, OwnSource]:
    """Makes the sources of the entries, in this order, by their names in batches and checkpoints.

    What an entry names is a class, or a function, that takes the context and the entry's settings
    as keyword arguments, and gives an object with

    - ``rows``, how many each batch has of it;
    - ``is_demo``, whether they count as demonstrations, or as the run's own experience;
    - ``sample(count)``, which gives rows ``[count]``: those of several batches at once;
    - where it has a state, ``state_dict()`` of tensors, numbers and strings, and
      ``load_state_dict``.

    Importing the file runs its code.

    Raises:
        ValueError: There is no such file, name or setting, it fails, or it gives something else.
    """
    return {f"own_source_{i}": OwnSource(entry, context) for i, entry in enumerate(entries)}


def _form(entry: Any) -> str:
    return f"{entry.dtype} {list(entry.shape[1:])}" if isinstance(entry, torch.Tensor) else "none"
