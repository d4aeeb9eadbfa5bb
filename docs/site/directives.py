"""What stands for ``<!-- generated: NAME -->`` in a page.

A directive is a function of the page (its front matter may say of what) that returns Markdown, or
text with links written as from the page's own folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from docs.site import (
    commands,
    curves,
    deviations,
    evaluation_figures,
    lab,
    settings,
    task_tables,
    variants,
)
from docs.site.page import Page
from docs.site.places import DOCS, ROOT
from docs.site.tables import code, table
from envs.demonstrations.readers import find_readers

MARK = re.compile(
    r"^<!-- generated: ([\w-]+) -->$(?:\n(?:(?!<!-- generated: ).)*?^<!-- end: \1 -->$)?",
    re.MULTILINE | re.DOTALL,
)
"""With what :mod:`docs.site.fill` put between it and its end."""


def expanded(page: Page) -> str:
    """The page's text with every mark replaced.

    Raises:
        KeyError: A mark names no directive.
        ValueError: The page lacks what a directive needs of its front matter.
    """

    def made(found: re.Match[str]) -> str:
        try:
            return DIRECTIVES[found[1]](page)
        except KeyError as error:
            raise ValueError(f"{page.path}: {found[0]} needs {error}") from error

    return MARK.sub(made, page.text)


def _methods(page: Page) -> str:
    pages = [Page.read(path) for path in sorted(page.path.parent.glob("*.md"))]
    lines = (
        (f"[{p.title}]({p.path.name})", ", ".join(map(code, p.about["variants"])), p.about["idea"])
        for p in pages
        if "variants" in p.about
    )
    return table(("method", "`VARIANT=`", "idea"), lines)


def _presets(_page: Page) -> str:
    files = sorted((ROOT / "configs" / "preset").glob("*.yaml"))
    return table(
        ("`PRESET=`", "what it is"),
        ((code(path.stem), (variants.comments(path) or [""])[0]) for path in files),
    )


def _formats(_page: Page) -> str:
    lines = ((reader.form, ", ".join(map(code, reader.suffixes))) for reader in find_readers())
    return table(("format", "names of files"), sorted(lines))


def _included(path: Path) -> Callable[[Page], str]:
    return lambda _page: path.read_text().strip()


DIRECTIVES: Mapping[str, Callable[[Page], str]] = {
    "settings": lambda _page: settings.render(),
    "targets": lambda _page: commands.render_targets(),
    "cli": lambda _page: commands.render_cli(),
    "evaluation": lambda _page: evaluation_figures.render(),
    "formats": _formats,
    "presets": _presets,
    "methods": _methods,
    "variant-yaml": lambda page: variants.yaml_of(page.about["variants"]),
    "deviations": lambda page: deviations.render(page.path.parent),
    "departures": lambda page: variants.departures(page.about["variants"]),
    "results": lambda page: variants.results(page.about["variants"]),
    "curve": curves.of_method,
    "cells": lambda page: task_tables.rows_of(page.about["variants"]),
    "tasks": lambda _page: task_tables.render(),
    "tasks-together": lambda _page: task_tables.aggregate(),
    "tasks-curves": curves.of_tasks,
    "tasks-profiles": curves.profiles,
    "results-curves": curves.of_results,
    "results-summary": _included(DOCS / "results" / "summary.md"),
    "results-tables": _included(DOCS / "results" / "tables.md"),
    "notes": lambda _page: lab.index(),
    "runs": lambda page: lab.results(page.about["rows"]),
    "data": lambda page: lab.data(page.about.get("rows", [])),
}
