"""Debian's chromium on the pages of a daemon of this machine, cut off from every other host."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, Request, Route, ViewportSize
from support.eventually import PATIENCE_S

EXECUTABLE = "/usr/bin/chromium"
PROXIED = "stonefall.plant"
"""Name of this machine behind a proxy."""
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    f"--host-resolver-rules=MAP {PROXIED} 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
ELSEWHERE = re.compile(
    rf"^(?!(http://127\.0\.0\.1[:/]|https://{re.escape(PROXIED)}[:/]|data:|blob:|about:)).*"
)
AXE = Path(__file__).parents[2] / "deploy/npm/node_modules/axe-core/axe.min.js"
SIZES: dict[str, ViewportSize] = {
    "wall": {"width": 1920, "height": 1080},
    "desktop": {"width": 1440, "height": 900},
    "tablet": {"width": 1024, "height": 768},
}
NOTE_ARRIVALS = """
window.arrivals = {};
new MutationObserver(() => {
  for (const each of document.querySelectorAll("[data-seq]")) window.arrivals[each.dataset.seq] ??= Date.now();
}).observe(document, { subtree: true, childList: true });
"""
"""Notes when a stone is on the page first, by the browser's clock."""


@dataclass
class Watched:
    """A page, with what it must not do."""

    page: Page
    is_expected: re.Pattern[str] = field(default_factory=lambda: re.compile(r"(?!)"))
    """Which errors in the console belong to the test, such as the refusal that it provokes."""
    elsewhere: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def assert_clean(self) -> None:
        """Fail if the page asked another host for anything, or left an error in the console."""
        assert self.elsewhere == []
        assert [error for error in self.errors if not self.is_expected.search(error)] == []


def launch(playwright: Playwright) -> Browser:
    return playwright.chromium.launch(executable_path=EXECUTABLE, args=FLAGS)


@contextmanager
def watched_page(browser: Browser, **options: Any) -> Iterator[Watched]:
    """A page of a browser that was never here before."""
    context = browser.new_context(**{"viewport": SIZES["desktop"], "locale": "en-GB", **options})
    watched = Watched(context.new_page())

    def refuse(route: Route) -> None:
        watched.elsewhere.append(route.request.url)
        route.abort()

    def note_request(request: Request) -> None:
        if ELSEWHERE.match(request.url):
            watched.elsewhere.append(request.url)

    def note_message(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            watched.errors.append(f"{message.text} {message.location.get('url')}")

    context.route(ELSEWHERE, refuse)
    context.on("request", note_request)
    watched.page.on("console", note_message)
    watched.page.on("pageerror", lambda error: watched.errors.append(str(error)))
    watched.page.add_init_script(NOTE_ARRIVALS)
    try:
        yield watched
    finally:
        context.close()


def until(page: Page, condition: str, argument: Any = None, patience_s: float = PATIENCE_S) -> None:
    """Return once a function of the page is true; `Page.wait_for_function` needs a page that allows `eval`."""
    deadline_s = time.monotonic() + patience_s
    while not page.evaluate(condition, argument):
        assert time.monotonic() < deadline_s, condition
        page.wait_for_timeout(20)


def first_paint_ms(page: Page) -> float:
    """Return when the first content was painted, since the address was asked for."""
    entry = "performance.getEntriesByType('paint').find(({name}) => name === 'first-contentful-paint')"
    until(page, f"() => {entry} !== undefined")
    return float(page.evaluate(f"{entry}.startTime"))


def violations(page: Page) -> list[str]:
    """Return the violations that axe-core finds in the page as it is painted."""
    page.locator("body").wait_for()  # visible
    if not AXE.exists():
        pytest.skip(f"axe-core is not there: deploy/packages puts it into {AXE.parent.name}, with npm")
    page.evaluate(AXE.read_text(encoding="utf-8"))  # not as a script of the page: its policy allows none
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        f"{each['id']}: {node['target']} {node['failureSummary']}" for each in found for node in each["nodes"]
    ]


def screenshot(page: Page, name: str) -> None:
    """Keep a picture of the page in the folder that STONEFALL_SCREENSHOTS names, if it does."""
    if folder := os.environ.get("STONEFALL_SCREENSHOTS"):
        page.locator("body").wait_for()  # visible, once the page is painted
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=True)


def reachable_by_tab(page: Page, most: int = 200) -> set[str]:
    """Press Tab until the focus is where it began; return the texts of all that had it."""
    page.evaluate("document.activeElement.blur()")
    reached: set[str] = set()
    for _ in range(most):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "(() => { const e = document.activeElement;"
            " return e === document.body ? null : (e.getAttribute('aria-label') ?? e.innerText ?? e.id).trim(); })()"
        )
        if name is None:
            break
        reached.add(name)
    return reached


def origin_of(url: str) -> str:
    """Return scheme, host and port of an address."""
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc}"
