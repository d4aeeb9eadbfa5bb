"""Every setting of a recipe and what it means, from the dataclasses that declare them.

A room says of a key what it means in a comment: beside it, or in the lines above it.
"""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, get_type_hints

from pydantic.dataclasses import is_pydantic_dataclass

from losses import SCHEDULES
from pipeline.dotted import join
from pipeline.recipe import Recipe

TYPES = {
    "Count": "int >= 1",
    "FurtherSettings": "dict[str, Any]",
    "Multiple": "float >= 1",
    "NotNegative": "int >= 0",
    "Positive": "float > 0",
    "Rate": "float >= 0",
    "ScheduleKind": " | ".join([*SCHEDULES, "path.py:NAME"]),
    "Share": "float, 0 to 1",
    "Widths": "list of int >= 1",
}
"""Names of ``pipeline.settings`` in words."""


@dataclass(frozen=True)
class Setting:
    """One key.

    Attributes:
        key: dotted, as a command line names it.
        kind: what values it takes, in words.
        default: as the source has it.
        meaning: what the comment says.
    """

    key: str
    kind: str
    default: str
    meaning: str


@dataclass(frozen=True)
class Section:
    """The keys of one dataclass of settings."""

    name: str
    kind: type[Any]
    settings: tuple[Setting, ...]

    @property
    def says(self) -> str:
        """First paragraph of the dataclass's docstring."""
        return (inspect.getdoc(self.kind) or "").split("\n\n")[0].replace("\n", " ")


def sections(kind: type[Any] = Recipe, name: str = "") -> Iterator[Section]:
    """The recipe's own keys, then those of every section, in the order of their declaration."""
    types = get_type_hints(kind)
    inner = {
        field.name: types[field.name]
        for field in fields(kind)
        if is_pydantic_dataclass(types[field.name])
    }
    yield Section(name, kind, tuple(_settings(kind, name, set(inner))))
    for key, section in inner.items():
        yield from sections(section, join(name, key))


@cache
def keys() -> frozenset[str]:
    """Every dotted key, sections included."""
    found = list(sections())
    told = {setting.key for section in found for setting in section.settings}
    return frozenset(told | {section.name for section in found})


def about(words: Sequence[str]) -> list[Setting]:
    """Settings in whose key or meaning all of ``words`` occur; all of them for no words.

    Raises:
        ValueError: If there is none.
    """
    every = [setting for section in sections() for setting in section.settings]
    found = [setting for setting in every if all(_is_about(setting, word) for word in words)]
    if not found:
        alone = f" (alone, {_alone(every, words)})" if len(words) > 1 else ""
        raise ValueError(
            f"no setting is about {' '.join(words)!r}{alone}: name a section ({_sections()}), a "
            "part of a key or a word of what it does, or leave it out for all of them"
        )
    return found


def _is_about(setting: Setting, word: str) -> bool:
    return word.lower() in f"{setting.key} {setting.meaning}".lower()


def _alone(every: Sequence[Setting], words: Sequence[str]) -> str:
    counts = {word: sum(_is_about(setting, word) for setting in every) for word in words}
    return " and ".join(f"{word!r} finds {count or 'none'}" for word, count in counts.items())


def _sections() -> str:
    return ", ".join(section.name for section in sections() if section.name)


def _settings(kind: type[Any], name: str, inner: set[str]) -> Iterator[Setting]:
    source = textwrap.dedent(inspect.getsource(kind))
    comments = _comments(source)
    (node,) = (n for n in ast.parse(source).body if isinstance(n, ast.ClassDef))
    for field in node.body:
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        if field.target.id in inner:
            continue
        yield Setting(
            join(name, field.target.id),
            _in_words(ast.unparse(field.annotation)),
            _default(field.value),
            _meaning(comments, field.lineno, field.end_lineno or field.lineno),
        )


def _default(value: ast.expr | None) -> str:
    if isinstance(value, ast.Call):  # field(default_factory=dict)
        factory = ast.unparse(value.keywords[0].value) if value.keywords else ast.unparse(value)
        return {"dict": "{}", "list": "[]"}.get(factory, factory)
    return "" if value is None else ast.unparse(value)


def _comments(source: str) -> dict[int, tuple[str, bool]]:
    """By line: a comment, and whether it has the line to itself."""
    found = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            alone = token.line.strip().startswith("#")
            found[token.start[0]] = (token.string.lstrip("# "), alone)
    return found


def _meaning(comments: dict[int, tuple[str, bool]], first: int, last: int) -> str:
    beside = [comments[line][0] for line in range(first, last + 1) if line in comments]
    above: list[str] = []
    line = first - 1
    while line in comments and comments[line][1]:
        above.insert(0, comments[line][0])
        line -= 1
    return " ".join(above + beside)


def _in_words(kind: str) -> str:
    for name, words in TYPES.items():
        if kind.split(" | ")[0] == name:
            return kind.replace(name, words)
    return kind
