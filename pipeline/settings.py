"""How the parts of a run declare their settings.

A room declares its own once, as a frozen dataclass beside the code that uses it::

    @dataclass(frozen=True, kw_only=True, config=STRICT)
    class SamplerSettings:
        batch_size: Count = 1024  # rows from the replay buffer

pydantic checks values wherever they come from, a YAML file, a command line or Python; together the
sections are a :class:`~pipeline.recipe.Recipe`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Annotated, Any, Final, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from pipeline.dotted import names

STRICT: Final = ConfigDict(extra="forbid", allow_inf_nan=False, validate_default=True)
"""Of every section: no unknown keys, no NaN."""


def _no_truth(value: Any) -> Any:
    if isinstance(value, bool):
        raise PydanticCustomError("number_expected", "Input should be a number, not true or false")
    return value


NUMBER: Final = BeforeValidator(_no_truth)
"""True is 1 to Python, and a slip on a command line."""
LARGEST: Final = 1e30
"""What float32 holds, and a few products of."""

Count = Annotated[int, NUMBER, Field(ge=1)]
NotNegative = Annotated[int, NUMBER, Field(ge=0)]
Seed = Annotated[int, NUMBER, Field(ge=0, lt=2**32)]
Positive = Annotated[float, NUMBER, Field(gt=0.0, le=LARGEST)]
Rate = Annotated[float, NUMBER, Field(ge=0.0, le=LARGEST)]
Share = Annotated[float, NUMBER, Field(ge=0.0, le=1.0)]
Multiple = Annotated[float, NUMBER, Field(ge=1.0, le=LARGEST)]
Widths = Annotated[tuple[Count, ...], Field(min_length=1)]

BOUNDS: Final[Mapping[str, str]] = {
    "greater_than": "more than {}",
    "greater_than_equal": "{} or more",
    "less_than": "less than {}",
    "less_than_equal": "{} or less",
}
"""What a value beyond a bound should have been, by pydantic's name of the error."""

Section = TypeVar("Section")


class SettingsError(ValueError):
    """A value is not possible; the message names its key and what was expected."""


def checked(kind: type[Section], values: Mapping[str, Any], where: str) -> Section:
    """The section ``kind`` with these values.

    Args:
        kind: A dataclass of settings.
        values: By key; sections within it are mappings.
        where: They come from, for the message.

    Raises:
        SettingsError: If a key is unknown, or a value is of another type or out of its range.
    """
    try:
        return TypeAdapter(kind).validate_python(dict(values))
    except ValidationError as error:
        raise SettingsError(f"{where}: {explained(error, values, _keys_of(kind))}") from error


def unknown_key(key: str, keys: Iterable[str]) -> str:
    """That there is no such key, and those of ``keys`` that are most like it."""
    alike = get_close_matches(key, list(keys), n=3)
    meant = f"did you mean {' or '.join(alike)}? All" if alike else "all"
    return f"there is no key {key}: {meant} are listed by: make settings"


def _keys_of(kind: type[Any]) -> list[str]:
    """Dotted keys of a section, sections within it and theirs; none if it has no defaults."""
    try:
        return list(names(plain(kind())))
    except (TypeError, ValidationError):
        return []


def explained(error: ValidationError, values: Mapping[str, Any], keys: Sequence[str] = ()) -> str:
    """What is wrong with ``values``, key by key, in one line.

    Args:
        error: Of pydantic.
        values: That were given, by key.
        keys: That exist.
    """
    found: dict[str, str] = {}
    for problem in error.errors(include_url=False):
        key = _key(problem["loc"], values) or "the settings"
        if problem["type"] == "unexpected_keyword_argument":
            found[key] = unknown_key(key, keys)
        elif problem["type"] == "value_error":  # of a section's own, which names its keys
            message = problem["msg"].removeprefix("Value error, ")
            found[message] = message
        elif key in found:  # another kind of value that the key may have, and this is none of
            found[key] += f", or {_expected(problem).removeprefix('must be ')}"
        else:
            found[key] = f"{key}={problem['input']!r}: {_expected(problem)}"
    return "; ".join(found.values())


def _expected(problem: ErrorDetails) -> str:
    """What a value must be, in our words and not pydantic's."""
    words = BOUNDS.get(problem["type"])
    if words is None:
        return problem["msg"].replace("Input should be ", "must be ")
    (bound,) = problem["ctx"].values()
    return f"must be {words.format(f'{bound:.10g}')}"


def _key(location: Sequence[int | str], values: Mapping[str, Any]) -> str:
    """The dotted key, without the names that pydantic gives the branches of a union."""
    parts: list[str] = []
    here: Any = values
    for part in location:
        if isinstance(here, Mapping):
            here = here.get(part)
        elif isinstance(here, list | tuple) and isinstance(part, int):
            here = here[part] if part < len(here) else None
        else:
            break
        parts.append(str(part))
    return ".".join(parts)


def plain(section: object) -> dict[str, Any]:
    """A section as plain values, for YAML and hashes."""
    dumped: dict[str, Any] = TypeAdapter(type(section)).dump_python(section, mode="json")
    return dumped
