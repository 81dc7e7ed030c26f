"""What a page has painted stays where it is: no card moves another when it fills, also where answers come late."""

from itertools import product

import pytest
from playwright.sync_api import Browser, expect
from support.browser import SIZES, origin_of, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick

PATIENCE_MS = 60_000
MAX_SHIFT = 0.1
"""Sum of the layout shifts (CLS) of a page that the web calls good. Stones that make room for the next do not count."""
LOOK_MS = 3000
"""How long a page is looked at once it is full."""
ANSWER_LATE = """
const later = (then) => setTimeout(then, 1500);
const ask = window.fetch;
window.fetch = async (...asked) => {
  if (String(asked[0]).includes("/api/")) await new Promise(later);
  return ask(...asked);
};
window.EventSource = class extends EventSource {
  addEventListener(type, told) { super.addEventListener(type, (event) => later(() => told(event))); }
};
"""
"""Delays all answers beyond what the first paint waits for."""
NOTE_SHIFTS = """
window.shifts = [];
new PerformanceObserver((list) => window.shifts.push(...list.getEntries()
  .filter(({ hadRecentInput }) => !hadRecentInput)
  .filter(({ sources }) => !sources.every(({ node }) => node?.parentElement?.closest("#newest")))
  .map(({ value, sources }) => ({ value, moved: sources.map(({ node, previousRect: a, currentRect: b }) =>
    `${node?.id || node?.parentElement?.id || node?.nodeName}: ${a.y} -> ${b.y}, ${a.height} -> ${b.height}`) }))))
  .observe({ type: "layout-shift", buffered: true });
"""
LIMITS = {
    "density_kg_m3": 2850,
    "lower_mm": 8,
    "upper_mm": 16,
    "specification": "astm-8",
}
VIEWPORTS = {**SIZES, "phone": {"width": 390, "height": 844}}
FULL = {"/": "#newest li", "/lots": "#list tbody tr", "/laboratory": "#studies > *", "/compare": "#a option"}
"""Each page, and what it shows last."""


@pytest.fixture(scope="module")
def plant(replay: DaemonProcess) -> DaemonProcess:
    """A daemon with products, closed lots and one that is open."""
    for number in range(4):
        replay.put(f"/products/basalt-{number}", {**LIMITS, "title": f"8/16 basalt {number}"})
    for number in range(5):
        replay.post("/lots", {"lot": f"L-{number}", "product": "basalt-1", "customer": "Straßenbau Süd"})
        if number < 4:
            replay.post(f"/lots/L-{number}/close", {})
    replay.wait_for("/results?limit=1", lambda page: page["last_seq"] > 12)
    return replay


@pytest.mark.parametrize(("path", "size", "is_late"), first_quick(product(FULL, VIEWPORTS, (True, False))))
@pytest.mark.full
def test_nothing_moves_after_the_first_paint(
    browser: Browser, plant: DaemonProcess, path: str, size: str, is_late: bool
) -> None:
    with watched_page(browser, viewport=VIEWPORTS[size]) as watched:
        page = watched.page
        if is_late:
            page.add_init_script(ANSWER_LATE)
        page.add_init_script(NOTE_SHIFTS)
        page.goto(origin_of(plant.url("")) + path)
        expect(page.locator(FULL[path]).first).to_be_attached(timeout=PATIENCE_MS)
        page.wait_for_timeout(LOOK_MS)
        shifts = page.evaluate("window.shifts")
        assert sum(shift["value"] for shift in shifts) <= MAX_SHIFT, shifts
        watched.assert_clean()
