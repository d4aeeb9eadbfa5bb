"""Parts of a run that stand in a user's own file, and the settings that a configuration gives them.

An entry is ``path.py:NAME``, or a mapping that has this under the part's key and keyword arguments
beside it: ``{term: my_terms.py:Centre, weight: 0.1}``.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from envs.library.functions import load_function
from envs.one_line import kind_and_text
from pipeline.literals import typed
from pipeline.settings import checked

Entry = str | dict[str, Any]


@dataclass(frozen=True)
class OwnParts:
    """One kind of such parts.

    Attributes:
        key: Of the configuration, which lists the entries.
        word: Key of ``path.py:NAME`` in a mapping.
        given: Arguments that the run itself passes, before an entry's keyword arguments.
        sections: Dataclasses of settings, by the keyword arguments that may be mappings of theirs.
        remedy: Ends the message about a setting that is not known.
    """

    key: str
    word: str
    given: int = 0
    sections: Mapping[str, type[Any]] = field(default_factory=dict)
    remedy: str = ""

    def checked(self, entry: Entry) -> Entry:
        """The entry; nothing is imported.

        Raises:
            ValueError: It names no file, or a value is no number, string, boolean or list of these.
        """
        if isinstance(entry, str):
            return entry
        if not isinstance(entry.get(self.word), str):
            raise ValueError(
                f"{self.key}: an entry {typed(entry)} needs {self.word}: path.py:NAME, beside "
                "which its other keys are settings"
            )
        for name, value in entry.items():
            if isinstance(value, Mapping) and name in self.sections:
                checked(self.sections[name], value, f"{self._asked(entry)}: {name}")
            elif not is_setting(value):
                raise ValueError(
                    f"{self._asked(entry)}: {name}={value!r} cannot be a setting; expected a "
                    "finite number, a string, true, false or a list of these"
                )
        return entry

    def where(self, entry: Entry) -> str:
        """``path.py:NAME``."""
        return entry if isinstance(entry, str) else str(entry[self.word])

    def files(self, entry: Entry) -> str:
        """Every ``path.py:NAME`` of an entry: its own, and those of its settings."""
        within = (getattr(one, "own_file", None) for one in self.options(entry).values())
        return ", ".join([self.where(entry), *(file for file in within if file)])

    def options(self, entry: Entry) -> dict[str, Any]:
        """The keyword arguments; mappings are made what they are settings of."""
        if isinstance(entry, str):
            return {}
        return {
            name: checked(self.sections[name], value, f"{self._asked(entry)}: {name}")
            if isinstance(value, Mapping)
            else value
            for name, value in entry.items()
            if name != self.word
        }

    def require(self, entries: Sequence[Entry]) -> None:
        """Refuses entries that cannot be called as they stand; it imports their files.

        Raises:
            ValueError: There is no such file or name, it has no such setting, or it needs another.
        """
        for entry in entries:
            make = load_function(self.key, self.where(entry))
            asked, name = self._asked(entry), self.where(entry).rpartition(":")[2]
            try:
                signature = inspect.signature(make)
            except (TypeError, ValueError):  # of a class that is not written in Python
                continue
            options = self.options(entry)
            known = _keywords(signature, self.given)
            unknown = [one for one in options if known is not None and one not in known]
            if unknown:
                raise ValueError(
                    f"{asked}: {name} has no setting {unknown[0]!r}; it has "
                    f"{', '.join(known or ()) or 'none'}{self.remedy}"
                )
            try:
                signature.bind(*[None] * self.given, **options)
            except TypeError as error:
                raise ValueError(f"{asked}: {name} cannot be called with these ({error})") from None

    def make(self, entry: Entry, *given: Any, **options: Any) -> Any:
        """Calls what an entry names.

        Args:
            entry: Of the configuration.
            given: What the run itself passes.
            options: Keyword arguments in place of the entry's own.

        Raises:
            ValueError: As :meth:`require`, or it raises something.
        """
        self.require([entry])
        make = load_function(self.key, self.where(entry))
        try:
            return make(*given, **self.options(entry) | options)
        # Whatever a user's class or function raises is told in one line.
        except Exception as error:
            raise ValueError(
                f"{self._asked(entry)}: it cannot be made ({kind_and_text(error)})"
            ) from error

    def refused(self, entry: Entry, why: str) -> ValueError:
        """An error about what an entry gives."""
        return ValueError(f"{self._asked(entry)} {why}")

    def _asked(self, entry: Entry) -> str:
        return f"{self.key}={typed(entry)}"


def _keywords(signature: inspect.Signature, given: int) -> list[str] | None:
    """Names that it takes as keywords beside what is given; None if it takes any."""
    parameters = list(signature.parameters.values())
    if any(one.kind is one.VAR_KEYWORD for one in parameters):
        return None
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    positional = [one for one in parameters if one.kind is not one.KEYWORD_ONLY][:given]
    return [one.name for one in parameters if one.kind in named and one not in positional]


def is_setting(value: Any) -> bool:
    """Whether a value is a finite number, a string, a boolean or a list of these."""
    if isinstance(value, list | tuple):
        return all(is_setting(one) for one in value)
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, bool | int | str)
