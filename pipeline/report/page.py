"""What a report consists of, and how it becomes a page or Markdown."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs
from tabulate import tabulate


@dataclass(frozen=True)
class Table:
    """Rows of text under headers; the first column names the row."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    caption: str = ""
    folded: bool = False
    """Whether it is closed, under its title, until it is asked for."""

    def markdown(self) -> str:
        """As a table of GitHub's Markdown."""
        rows = [[str(cell).replace("|", "\\|") for cell in row] for row in self.rows]
        return tabulate(rows, headers=self.headers, tablefmt="github", disable_numparse=True)


@dataclass(frozen=True)
class Chart:
    """A figure of plotly as JSON."""

    title: str
    figure: str
    wide: bool = False
    """Takes the whole width of the page."""
    over: Mapping[str, str] = field(default_factory=dict)
    """The same over the other axes of its section, by their keys."""


@dataclass(frozen=True)
class Clip:
    """A film in the page itself."""

    title: str
    uri: str
    """``data:video/mp4;base64,...`` or ``data:image/gif;base64,...``."""

    @property
    def still(self) -> bool:
        """Whether the browser shows it as a picture, which plays by itself."""
        return self.uri.startswith("data:image/")


@dataclass(frozen=True)
class Section:
    """A part of the report under one heading.

    Attributes:
        key: anchor on the page.
        title: heading.
        text: what it shows and how to read it.
        tables: in both forms.
        charts: of the page only.
        clips: of the page only.
        folded: whether the charts are closed until they are asked for.
        axes: labels by key of what its curves can be read over, the charts' own first; none where
            there is no choice.
        absent: what cannot be shown and why, a line each.
        told: whether it has its place also with nothing but that.
    """

    key: str
    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()
    clips: Sequence[Clip] = ()
    folded: bool = False
    axes: Mapping[str, str] = field(default_factory=dict)
    absent: Sequence[str] = field(default_factory=tuple)
    told: bool = False

    @property
    def empty(self) -> bool:
        """Whether it has nothing to show, only reasons why not."""
        return bool(self.absent) and not (self.told or self.tables or self.charts or self.clips)


NAMED: Final = 6
"""Rows or runs that are named where something is lacking; of more the number is told."""


def told_once(lacking: Mapping[str, str], everything: Collection[str], what: str) -> list[str]:
    """What is lacking by row or run, as a line for each reason.

    Args:
        lacking: Reasons by name.
        everything: Names of all that could lack it; they are not listed where all of them do.
        what: What they are, in the plural.
    """
    names: dict[str, list[str]] = {}
    for name, reason in lacking.items():
        names.setdefault(reason, []).append(name)
    every = set(everything)
    return [
        f"all {len(of)} {what}: {reason}"
        if len(of) > 1 and every == set(of)
        else f"{_listed(of)}: {reason}"
        for reason, of in names.items()
    ]


def _listed(names: Sequence[str]) -> str:
    further = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {further} more" if further > 0 else "")


@dataclass(frozen=True)
class Report:
    """A whole report."""

    title: str
    summary: str
    sections: Sequence[Section]

    @property
    def shown(self) -> list[Section]:
        """Sections with a place of their own."""
        return [section for section in self.sections if not section.empty]

    @property
    def lacking(self) -> list[Section]:
        """Sections of which only the reasons are told, together at the end."""
        return [section for section in self.sections if section.empty]

    def html(self) -> str:
        """One file that needs no network: styles, plotly and data are in it."""
        template = _environment(escape=True).get_template("report.html.j2")
        return template.render(report=self, plotly=Markup(get_plotlyjs()), json_of=_inline)

    def markdown(self) -> str:
        """The tables, without the charts."""
        return _environment(escape=False).get_template("report.md.j2").render(report=self)


def _environment(*, escape: bool) -> Environment:
    return Environment(
        loader=PackageLoader("pipeline.report"),
        autoescape=escape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def _inline(figure: str) -> Markup:
    """JSON that cannot end the script element around it."""
    return Markup(figure.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
