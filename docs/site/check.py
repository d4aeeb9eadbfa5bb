"""Looks at the finished site: links lead somewhere, and nothing is fetched from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src"}
"""What a browser loads by itself; a stylesheet, which is a link, besides."""
OUTWARD = ("http", "https", "mailto", "data", "javascript")
OWN = "404.html"
"""Its links begin at the root of a server."""


@dataclass
class _Seen(HTMLParser):
    """Anchors, links and what is loaded, of one page."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value for key, value in attrs if value is not None}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in FETCHED and FETCHED[tag] in given:
            self.loaded.append(given[FETCHED[tag]])
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preconnect"):
            self.loaded.append(given.get("href", ""))


def problems(site: Path) -> list[str]:
    """A line for every dead link and everything that a page would fetch from another host."""
    pages = {path: _read(path) for path in sorted(site.rglob("*.html")) if path.name != OWN}
    return [f"{path.relative_to(site)}: {told}" for path in pages for told in _of(path, pages)]


def _read(path: Path) -> _Seen:
    seen = _Seen()
    seen.feed(path.read_text())
    return seen


def _of(path: Path, pages: dict[Path, _Seen]) -> Iterator[str]:
    seen = pages[path]
    yield from (f"loads {url}" for url in seen.loaded if _elsewhere(url))
    for url in seen.links:
        if (wrong := _dead(path, url, pages)) is not None:
            yield f"{url} {wrong}"


def _elsewhere(url: str) -> bool:
    return urlsplit(url).scheme in ("http", "https") or url.startswith("//")


def _dead(path: Path, url: str, pages: dict[Path, _Seen]) -> str | None:
    parts = urlsplit(url)
    if parts.scheme in OUTWARD:
        return None
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    target = target / "index.html" if target.is_dir() else target
    if not target.exists():
        return "leads nowhere"
    if parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "names an anchor that is not there"
    return None
