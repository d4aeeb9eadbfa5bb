"""Pages of the Python interface: a page a package, its modules by mkdocstrings."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from docs.site.places import ROOT

PACKAGES = ("losses", "envs", "pipeline", "configs")
FOLDER = PurePosixPath("reference/python")


def write(out: Path) -> list[PurePosixPath]:
    """Writes the pages below ``out`` and returns their places."""
    places = []
    for package in PACKAGES:
        place = FOLDER / f"{package}.md"
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        (out / place).write_text(page(package))
        places.append(place)
    return places


def page(package: str) -> str:
    """Every module of a package whose names, and its folders', are public."""
    parts = [f"# Python: `{package}`", *(f"::: {module}" for module in modules(package))]
    return "\n\n".join(parts) + "\n"


def modules(package: str) -> list[str]:
    """Names of the modules that define something, in the order of their files."""
    found = []
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__" or any(part.startswith("_") for part in parts):
            continue
        found.append(".".join(parts))
    return found
