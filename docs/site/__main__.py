"""``python -m docs.site [OUT]``: builds the site, and fails on any warning or dead link."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from docs.site import api, check
from docs.site.build import build_pages
from docs.site.navigation import navigation
from docs.site.places import ROOT

STAGE = ROOT / "build" / "docs"
CONFIG = Path(__file__).parent / "zensical.toml"


def main(out: Path) -> None:
    """Writes the pages to ``build/docs``, the site to ``out``.

    Raises:
        SystemExit: What is wrong, a line for each finding.
    """
    shutil.rmtree(STAGE, ignore_errors=True)
    pages = STAGE / "pages"
    build_pages(pages)
    places = api.write(pages)
    (STAGE / "zensical.toml").write_text(_config(navigation(places)))
    zensical = Path(sys.executable).with_name("zensical")
    command = [os.environ.get("ZENSICAL", str(zensical)), "build", "--clean", "--strict"]
    done = subprocess.run(command, cwd=STAGE, check=False)
    if done.returncode:
        sys.exit("the site is not built: mend what the lines above name")
    if found := check.problems(STAGE / "site"):
        sys.exit("\n".join([*found, f"{len(found)} links of the site lead nowhere or elsewhere"]))
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(STAGE / "site", out)
    print(f"written to {out}: python -m http.server -d {out}")  # noqa: T201 - a command's output


def _config(nav: list[dict[str, object]]) -> str:
    """The committed configuration with what is found out: TOML's inline tables are JSON with =."""
    added = f'docs_dir = "pages"\nsite_dir = "site"\nnav = {_toml(nav)}\n'
    return CONFIG.read_text().replace("[project]\n", f"[project]\n{added}", 1)


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "site"))
