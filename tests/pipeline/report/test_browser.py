"""The page in Chromium, where one is installed: no error, no request, every control does something.

Screenshots of every width and colour scheme are left in the folder that ``REPORT_SCREENSHOTS``
names, if it does: some faults only a person sees.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.report.build import write_report
from tests.pipeline.report.making import curve, make_run

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "chromium-headless-shell")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
MISSING = "no Chromium here; on Debian: apt-get install chromium (CONTRIBUTING.md, Tests)"
WIDTHS = (390, 1440)
SCHEMES = ("light", "dark")
LEAST_CONTRAST = 4.5
"""Of text to what is behind it: level AA of the Web Content Accessibility Guidelines 2.2."""
TRACES = """place => place.data.filter(trace => trace.showlegend !== false)
    .map(trace => [trace.name, trace.visible !== "legendonly"])"""
DRAWN = "document.querySelectorAll('.chart.js-plotly-plot .main-svg').length"
CONTRAST = """() => {
  const light = text => {
    const parts = text.match(/[\\d.]+/g).map(Number), part = parts.slice(0, 3).map(value => {
      const share = value / 255;
      return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
  };
  const behind = place => {
    for (let at = place; at; at = at.parentElement) {
      const colour = getComputedStyle(at).backgroundColor;
      if (!/, 0\\)$/.test(colour) && colour !== "transparent") return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const seen = {};
  for (const place of document.querySelectorAll("p, a, h1, h2, h3, th, td, li, summary, figcaption, .switch span, svg text")) {
    if (!place.textContent.trim() || !place.getClientRects().length) continue;
    const style = getComputedStyle(place), svg = place.namespaceURI.endsWith("svg");
    const colour = svg ? style.fill : style.color;
    // Numbers in the cells of a heat map stand on its colours.
    if (svg && place.closest(".heatmaplayer, .hm")) continue;
    const [a, b] = [light(colour), light(behind(place))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    const kind = place.tagName + " " + colour;
    if (!(kind in seen) || ratio < seen[kind]) seen[kind] = ratio;
  }
  return seen;
}"""  # noqa: E501 - of the page's own language

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason=MISSING),
]


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report in which every kind of section has something to show."""
    folder = tmp_path_factory.mktemp("report")
    words = {"grasp": "led by a grasp", "flung": "let go"}
    ways = {
        "shares": {"grasp": 0.7, "flung": 0.3}, "words": words, "thresholds": {"untouched": 0.25},
        "sensitivity": {"untouched": {"0.1": {"grasp": 0.6, "flung": 0.4}}},
        "kept_at_end": {"grasp": 0.9, "flung": 0.5}, "lost_at_end": 0.1,
        "progress_at_last_contact": [1.0, 1.2, 1.4], "travel_untouched_mean": 0.2,
    }  # fmt: skip
    for row in range(5):  # of which one panel shows four
        for seed in range(3):
            points = [
                {**point, "simulator_steps": point["frames"] + 500, "wall_s": 60.0 * n,
                 "q_demo_actions": 10.0, "q_policy_actions": 10.5 + seed}
                for n, point in enumerate(curve(0.1 * row, 0.2 + 0.1 * seed, 0.5 + 0.1 * seed))
            ]  # fmt: skip
            make_run(
                folder / "runs" / f"row_{row}" / f"seed{seed}", seed=seed, successes=4 + seed,
                points=points, further={"strategies": ways}, gamma=row,
            )  # fmt: skip
    make_run(folder / "runs" / "older" / "seed0")
    write_report([folder / "runs"], folder)
    return folder / "index.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no playwright here; make install EXTRAS=dev"
    )
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(params=[(w, s) for w in WIDTHS for s in SCHEMES], ids=lambda p: f"{p[0]}-{p[1]}")
def page(request: pytest.FixtureRequest, browser: Any, page_file: Path) -> Iterator[Any]:
    """The page with all of its charts drawn; whatever it complains of fails the test."""
    width, scheme = request.param
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True
    )
    opened = context.new_page()
    opened.set_default_timeout(60_000)
    faults: list[str] = []
    opened.on("console", lambda said: faults.append(f"{said.type}: {said.text}"))
    opened.on("pageerror", lambda error: faults.append(str(error)))
    opened.on("requestfailed", lambda asked: faults.append(f"failed: {asked.url[:80]}"))
    asked: list[str] = []
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(page_file.as_uri())
    opened.wait_for_function(
        "[...document.querySelectorAll('.chart')].filter(c => !c.closest('details'))"
        ".every(c => c.querySelectorAll('.main-svg').length === 3)"
    )
    yield opened
    assert faults == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    context.close()


def test_every_control_does_what_it_says(page: Any, request: pytest.FixtureRequest):
    _open_everything(page)
    _picture(page, request, "frames")
    _switch_axes(page)
    _click_legends(page)
    _follow_links(page)


def test_it_can_be_read(page: Any):
    """Nothing is wider than the page, cut off, or hard to tell from what is behind it."""
    _open_everything(page)
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    rights = page.eval_on_selector_all(
        "figure, .switch, p, h2, nav", "found => found.map(f => f.getBoundingClientRect().right)"
    )
    assert max(rights) <= width
    # Ticks, titles and legends end within their chart.
    cut = page.evaluate(
        """[...document.querySelectorAll('.chart')].flatMap(chart => {
          const room = chart.getBoundingClientRect();
          return [...chart.querySelectorAll('text')].filter(text => text.textContent.trim())
            .map(text => [text.textContent, text.getBoundingClientRect()])
            .filter(([, at]) => at.width && (at.left < room.left - 1 || at.right > room.right + 1))
            .map(([says]) => says);
        })"""
    )
    assert cut == []
    contrast = page.evaluate(CONTRAST)
    assert contrast
    assert {kind: ratio for kind, ratio in contrast.items() if ratio < LEAST_CONTRAST} == {}


def test_colours_follow_the_scheme_while_the_page_is_open(page: Any):
    def colours() -> list[str]:
        body = page.evaluate("getComputedStyle(document.body).backgroundColor")
        text = page.evaluate("getComputedStyle(document.querySelector('.xtick text')).fill")
        return [body, text]

    before = colours()
    dark = page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    page.emulate_media(color_scheme="light" if dark else "dark")
    page.wait_for_timeout(500)
    after = colours()
    assert all(a != b for a, b in zip(before, after, strict=True)), (before, after)


def _open_everything(page: Any) -> None:
    """Every fold opens by its title, and what is in it is drawn."""
    folds = page.locator("details")
    assert folds.count() >= 2
    for number in range(folds.count()):
        fold = folds.nth(number)
        inside = fold.locator(".scroll, .charts").first
        assert not inside.is_visible()
        fold.locator("summary").click()
        assert inside.is_visible()
    page.wait_for_function(f"{DRAWN} === 3 * document.querySelectorAll('.chart').length")


def _switch_axes(page: Any) -> None:
    """Every choice of every switch gives its charts that axis, and none of another section."""
    switches = page.locator(".switch")
    assert switches.count() == 2
    for number in range(switches.count()):
        switch = switches.nth(number)
        section = switch.locator("xpath=ancestor::section")
        charts = section.locator(".chart")
        labels = switch.locator("label").all_inner_texts()
        assert labels == ["environment frames", "simulator steps", "wall time (min)"]
        ends = set()
        for label in [*labels[1:], labels[0]]:
            switch.get_by_text(label, exact=True).click()
            for place in charts.all():
                handle = place.element_handle()
                page.wait_for_function(
                    "([place, label]) => place.querySelector('.xtitle').textContent === label",
                    arg=[handle, label],
                )
            ends.add(charts.first.evaluate("place => place.data.at(-1).x.at(-1)"))
        assert len(ends) == 3, "the same curve stands at other places"


def _click_legends(page: Any) -> None:
    """A name in a legend takes its line, and the band around it, away and back."""
    chart = page.locator("#curves .chart").first
    before = chart.evaluate(TRACES)
    assert len(before) > 1
    assert all(shown for _, shown in before)
    bands = chart.locator(".scatterlayer .trace")
    drawn = bands.count()
    entry = chart.locator(".legendtoggle").nth(1)  # the first row has one seed, and no band
    entry.click()
    page.wait_for_function("place => place.data.some(trace => trace.visible === 'legendonly')",
                           arg=chart.element_handle())  # fmt: skip
    assert [shown for _, shown in chart.evaluate(TRACES)] == [n != 1 for n in range(len(before))]
    assert bands.count() == drawn - 2, "line and band"
    page.wait_for_timeout(600)  # two clicks soon after one another are another gesture
    entry.click()
    page.wait_for_function("place => place.data.every(trace => trace.visible !== 'legendonly')",
                           arg=chart.element_handle())  # fmt: skip
    assert bands.count() == drawn


def _follow_links(page: Any) -> None:
    links = page.locator("nav a")
    assert links.count() > 5
    for number in range(links.count()):
        links.nth(number).click()
        key = page.evaluate("location.hash.slice(1)")
        heading = page.locator(f"[id='{key}']")
        assert heading.count() == 1, key
        assert links.nth(number).inner_text() == heading.locator("h2").first.inner_text()


def _picture(page: Any, request: pytest.FixtureRequest, name: str) -> None:
    if (folder := os.environ.get("REPORT_SCREENSHOTS")) is not None:
        path = Path(folder) / f"{request.node.callspec.id}-{name}.png"
        page.screenshot(path=path, full_page=True)
