"""The page in a browser, where one is at hand: charts are drawn and nothing is wider than it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from pipeline.report.build import write_report
from tests.pipeline.report.making import make_run

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
FRAME = """<!doctype html><body><iframe src="index.html" width="{width}" height="2000"></iframe>
<script>
const look = () => {{
  const page = document.querySelector("iframe").contentDocument;
  const all = what => page.querySelectorAll(what);
  const wide = page.documentElement.scrollWidth, rights = [...all("figure")]
    .map(figure => figure.getBoundingClientRect().right);
  const drawn = all(".chart .main-svg").length;
  document.title = [all(".chart").length, drawn, wide, Math.max(...rights)];
}};
addEventListener("load", () => setInterval(look, 500));
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_charts_are_drawn_and_fit(tmp_path: Path, width: int, scheme: str):
    for name in ("first", "second"):
        make_run(tmp_path / "a" / name / "seed0", gamma=name)
    report = write_report([tmp_path / "a"], tmp_path)
    (tmp_path / "frame.html").write_text(FRAME.format(width=width))
    assert BROWSER is not None
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files",
        f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1600,2000",
        f"--blink-settings=preferredColorScheme={0 if scheme == 'dark' else 1}",
        "--virtual-time-budget=20000", "--dump-dom", (tmp_path / "frame.html").as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=True)
    found = re.search(r"<title>(.*?)</title>", done.stdout)
    assert found is not None, done.stdout[:500]
    charts, drawn, wide, right = (float(part) for part in found.group(1).split(","))
    assert charts == sum(len(part.charts) for part in report.sections)
    assert drawn == 3 * charts  # layers of plotly
    assert wide <= width
    assert right <= width
