"""``key=value`` on top of a recipe, of commands that do not go through Hydra."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml

from envs.one_line import text_of
from pipeline.dotted import flatten, nest
from pipeline.literals import LITERAL, literal
from pipeline.recipe import Recipe
from pipeline.settings import SettingsError


class _TypedValues(yaml.SafeLoader):
    """Values as Hydra reads them where a run is new: YAML has 010 for 8, 1:30 for 90, no for false.

    A number that is none of Python's stays a string, which the key's own type refuses.
    """


_TypedValues.yaml_implicit_resolvers = {}
for _tag, _form, _first in (
    ("bool", r"(?i:true|false)", "tTfF"),
    ("null", r"(?i:null)", "nN"),
    ("int", r"[-+]?[0-9]+(_[0-9]+)*", "-+0123456789"),
    ("float", r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?(?i:inf|nan)", "-+iInN"),
):
    _TypedValues.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_form})$"), list(_first)
    )
_TypedValues.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(node.value))
_TypedValues.add_constructor("tag:yaml.org,2002:float", lambda _, node: float(node.value))


def recipe_of(overrides: Sequence[str]) -> Recipe:
    """The recipe that nothing but ``key=value`` describes, of commands that train nothing.

    Raises:
        SettingsError: If one is not possible.
    """
    recipe = Recipe()
    for override in overrides:
        recipe = overridden(recipe, override.lstrip("+"))
    return recipe


def overridden(recipe: Recipe, override: str) -> Recipe:
    """The recipe with one ``key=value`` on top.

    Raises:
        SettingsError: If it has another form, or the key or value is not possible.
    """
    return recipe.changed(**nest(*_parsed(override)))


def keys_of(override: str) -> set[str]:
    """Dotted keys of the values that one ``key=value`` sets; a mapping sets several.

    Raises:
        SettingsError: If it has another form.
    """
    return set(flatten(nest(*_parsed(override))))


def _parsed(override: str) -> tuple[str, Any]:
    """Key and value."""
    name, separator, text = override.partition("=")
    if not separator:
        raise SettingsError(f"{override!r} is not of the form key=value")
    try:
        change: Any = (
            literal(text) if name in LITERAL or not text else yaml.load(text, _TypedValues)
        )
    except (yaml.YAMLError, ValueError) as error:
        raise SettingsError(f"{override!r}: its value cannot be read ({text_of(error)})") from error
    return name, change
