"""The pages in a real browser: nothing goes wrong, nothing is fetched, controls work, and it can be read anywhere."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from small_runs import BC, OWN, write_plain

import guider
from guider import api
from guider.data import load

COMMANDS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium: that of `make browser`, or one that is installed."""
    api = pytest.importorskip("playwright.sync_api", reason="`make browser` installs playwright and a Chromium")
    ours = Path(sys.prefix, "browser", "chromium")
    found = str(ours) if ours.exists() else next(filter(None, map(shutil.which, COMMANDS)), None)
    if found is None:
        pytest.skip("no Chromium here; `make browser` fetches one")
    with api.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=found, args=["--no-sandbox", "--no-zygote", "--disable-gpu"])
        yield running
        running.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """A report on two runs whose goals are places, one on a run whose goal is one entry, and a page about logs."""
    folder = tmp_path_factory.mktemp("pages")
    logs = load(write_plain(folder / "plain.npz"), (0, 1))
    guider.save_data(logs, folder / "logs.npz")
    api.inspect(folder / "logs.npz", report=folder / "logs.html")
    line: dict[str, Any] = OWN | {"goal_indices": (0,)}
    runs = [
        guider.train(data=folder / "logs.npz", out=folder / "guided", **OWN),
        guider.train(data=folder / "logs.npz", out=folder / "cloned", **BC),
        guider.train(data=folder / "logs.npz", out=folder / "line", **line),
    ]
    for run in runs:
        guider.evaluate(run)
    return {
        "plane": api.report(runs[:2], folder / "plane.html"),
        "line": api.report(runs[2:], folder / "line.html"),
        "logs": folder / "logs.html",
    }


class Opened:
    """A page in the browser, and what it complained of or asked the network for."""

    def __init__(self, browser: Any, path: Path, width: int = 1000, scheme: str = "light"):
        self.page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
        self.wrong: list[str] = []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on(
            "console", lambda said: self.wrong.append(said.text) if said.type in ("error", "warning") else None
        )
        self.page.on("request", lambda asked: self.wrong.append(asked.url[:80]) if not _own(asked.url, path) else None)
        self.page.goto(path.as_uri())
        for control in self.page.query_selector_all("details"):
            control.evaluate("node => node.open = true")

    def told(self) -> str:
        return self.page.inner_text("#told")

    def choose(self, control: str, value: int | str) -> None:
        self.page.select_option(f"#{control}", str(value))


def _own(url: str, path: Path) -> bool:
    return url.startswith("data:") or url == path.as_uri()


@pytest.mark.parametrize("name", ["plane", "line", "logs"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1000])
def test_it_opens_without_a_word_and_can_be_read(browser, pages, name, scheme, width):
    opened = Opened(browser, pages[name], width, scheme)
    assert opened.page.evaluate("document.scrollingElement.scrollWidth") <= width
    ink, back = (
        opened.page.evaluate(f"getComputedStyle(document.body).{part}") for part in ("color", "backgroundColor")
    )
    assert _contrast(ink, back) >= 4.5 and (_light(back) > 0.5) == (scheme == "light")
    shown = opened.page.evaluate(
        "[...document.images].map(i => { i.loading = 'eager'; return i.decode().then(() => i.naturalWidth) })"
    )
    assert len(shown) >= 2
    assert opened.wrong == []
    opened.page.close()


def test_an_episode_is_scrubbed_played_and_changed(browser, pages):
    opened = Opened(browser, pages["plane"])
    page = opened.page
    last = int(page.get_attribute("#step", "max"))
    assert last > 5 and int(page.input_value("#step")) == last
    line = "#plane polyline"
    whole = page.get_attribute(line, "points")
    page.evaluate("step.value = 2; step.dispatchEvent(new Event('input'))")
    assert opened.told().startswith("step 2: ") and whole.startswith(page.get_attribute(line, "points"))
    assert len(page.get_attribute(line, "points").split()) == 3

    page.click("#play")
    assert page.inner_text("#play") == "stop"
    page.wait_for_timeout(400)
    assert int(page.input_value("#step")) > 3
    page.click("#play")
    stopped = page.input_value("#step")
    page.wait_for_timeout(200)
    assert page.inner_text("#play") == "play" and page.input_value("#step") == stopped

    ways = set()
    for episode in range(page.locator("#episode option").count()):
        opened.choose("episode", episode)
        assert page.input_value("#step") == page.get_attribute("#step", "max")
        ways.add(page.get_attribute(line, "points"))
    assert whole in ways and len(ways) > 1
    reached = page.locator("#plane g circle").count()
    opened.choose("run", 1)  # one without a prior: the robot and where it goes, no samples
    assert page.locator("#plane g circle").count() == 2 < reached
    assert opened.wrong == []
    page.close()


def test_curves_of_all_runs_lie_over_one_another(browser, pages):
    opened = Opened(browser, pages["plane"])
    names = opened.page.locator("#metric option").all_inner_texts()
    assert len(names) > 3
    drawn = set()
    for name in names:
        opened.choose("metric", name)
        drawn.add(opened.page.inner_html("#curve"))
        assert opened.page.locator("#legend span").count() == opened.page.locator("#curve polyline").count() >= 1
    assert len(drawn) > 3 and opened.wrong == []
    opened.page.close()


def _light(colour: str) -> float:
    """Relative luminance (WCAG 2) of `rgb(r, g, b)`."""
    parts = [int(part) / 255 for part in colour.removeprefix("rgb(").removesuffix(")").split(",")]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(ink: str, back: str) -> float:
    dark, light = sorted((_light(ink), _light(back)))
    return (light + 0.05) / (dark + 0.05)
