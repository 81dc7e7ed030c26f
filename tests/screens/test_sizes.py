"""Each page on a wall, a tablet and a phone: nothing runs over, drawings can be read, and alarms are seen at once."""

import re
from itertools import product
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect
from support.browser import SIZES, origin_of, screenshot, until, violations, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick
from support.lots import PRODUCT

from screens.test_lots_page import PHONE

PATIENCE_MS = 60_000
LEAST_LETTER_PX = 11
MOST_HEADER_PX = 64
VIEWPORTS = {"phone": PHONE, "tablet": SIZES["tablet"], "wall": SIZES["wall"]}
PAGES = {
    "/": "#trend svg",
    "/gallery?lot=L-0": "#distribution svg",
    "/compare?a=L-0&b=L-1&lot=L-0&lot=L-1": "#overlay svg",
    "/stones/STONE": "#numbers table",
    "/lots": "#list tbody tr",
    "/laboratory?lot=L-0": "#entry > *",
    "/setup#places": "#wizard > *",
    "/setup#calibration": "#wizard > *",
    "/setup#verification": "#wizard > *",
    "/setup#recording": "#wizard > *",
    "/setup#webhooks": "#wizard > *",
    "/setup#screens": "#wizard > *",
    "/shift": "#sheet h1",
    "/verify": "#form",
    "/sign-in": "#form",
}
"""Each page, and what it shows last."""
RUNNING_OVER = """() => [...document.querySelectorAll("#tiles .tile, #camera-tiles button, #wizards a, .steps li")]
  .filter((each) => each.checkVisibility() && each.scrollWidth > each.clientWidth)
  .map((each) => `${each.innerText}: ${each.scrollWidth} > ${each.clientWidth}`)"""
SMALL_LETTERS = """(least) => [...document.querySelectorAll("svg.sf-curve text, svg.chart text, svg.space text")]
  .filter((each) => each.checkVisibility())
  .map((each) => ({ font: parseFloat(getComputedStyle(each).fontSize), to: each.getScreenCTM() }))
  .filter(({ font, to }) => font * Math.hypot(to.a, to.b) < least - 0.01)"""
"""Texts of drawings below a height on the screen, which is that of the font by the scale of the drawing."""
ALARM = {
    "check": "optics",
    "cause": "Eine Kamera sieht schlecht: Staub, Licht oder Schärfe hat die Hälfte der Grenze überschritten.",
    "action": "Fenster, Objektiv und Wand der genannten Kameras reinigen; die genannte Leuchte, dann Schärfe prüfen.",
    "priority": "medium",
    "state": "unacknowledged",
    "findings": [{"code": "reported", "subjects": ["c03"], "parameters": {"reported": "dim"}}] * 2,
    "raised_at": "2026-03-01T10:00:00.000Z",
    "occurrences": 2,
    "acknowledged_by": None,
    "detail": "c03: dim",
}  # fmt: skip


@pytest.fixture(scope="module")
def plant(replay: DaemonProcess) -> DaemonProcess:
    """A daemon with two closed lots, and one that is open."""
    replay.put("/products/basalt", PRODUCT)
    for number in range(3):
        assert replay.post("/lots", {"lot": f"L-{number}", "product": "basalt"})["lot"] == f"L-{number}"
        replay.wait_for(f"/lots/L-{number}/gradation", lambda lot: lot["measured"] > 4)
        if number < 2:
            replay.post(f"/lots/L-{number}/close?wait_s=20", {})
    return replay


def show(page: Page, plant: DaemonProcess, path: str, language: str = "de") -> None:
    """Open a page in a language and wait until it is full."""
    page.set_default_timeout(PATIENCE_MS)
    stone = plant.get("/particles?outcome=measured&limit=1")["items"][0]["id"]
    address, _, wizard = path.replace("STONE", stone).partition("#")
    separator = "&" if "?" in address else "?"
    page.goto(f"{origin_of(plant.url(''))}{address}{separator}language={language}#{wizard}")
    page.locator(PAGES[path]).first.wait_for(state="attached")


@pytest.mark.parametrize(("path", "size"), first_quick(product(PAGES, VIEWPORTS)))
@pytest.mark.full
def test_a_page_fits_and_its_drawings_can_be_read(
    browser: Browser, plant: DaemonProcess, path: str, size: str
) -> None:
    with watched_page(browser, viewport=VIEWPORTS[size], reduced_motion="reduce") as watched:
        page = watched.page
        # of the screenshot, by a driver in software; and stones that fall meanwhile may take this one's frames away
        watched.is_expected = re.compile(r"GPU stall due to ReadPixels|404 .*/views/c\d\d\.png$")
        show(page, plant, path)
        until(page, f"() => ({SMALL_LETTERS})({LEAST_LETTER_PX}).length === 0")
        screenshot(page, f"sizes-{path.strip('/').partition('?')[0].replace('/', '-')}-{size}")
        assert page.evaluate(RUNNING_OVER) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= VIEWPORTS[size]["width"]
        assert page.locator("#header .bar").bounding_box()["height"] <= MOST_HEADER_PX  # type: ignore[index] - is shown
        assert violations(page) == []
        watched.assert_clean()


@pytest.mark.parametrize("size", ["tablet", "phone"])
@pytest.mark.full
def test_what_has_no_room_in_the_header_is_in_a_menu(
    browser: Browser, plant: DaemonProcess, size: str
) -> None:
    with watched_page(browser, viewport=VIEWPORTS[size]) as watched:
        page = watched.page
        show(page, plant, "/verify", "en")
        theme, menu = page.get_by_role("button", name="Theme: "), page.get_by_role("button", name="Menu")
        expect(theme).to_be_hidden()
        menu.focus()
        page.keyboard.press("Enter")
        expect(theme).to_be_visible()
        assert violations(page) == []
        page.keyboard.press("Escape")
        expect(theme).to_be_hidden()
        expect(menu).to_be_focused()
        menu.click()
        page.get_by_role("link", name="Stones").click()
        expect(page.locator("#filters")).to_be_visible()
        watched.assert_clean()


@pytest.mark.full
def test_verdict_and_three_alarms_are_seen_at_once_on_a_tablet(
    browser: Browser, plant: DaemonProcess
) -> None:
    def answer(number: int) -> dict[str, Any]:
        return {**ALARM, "id": number}

    with watched_page(browser, viewport=SIZES["tablet"]) as watched:
        page = watched.page
        raised = {"items": [answer(number) for number in range(3)], "shelved": [], "suppressed": []}
        page.route("**/api/v1/alarms?*", lambda route: route.fulfill(json=raised))
        show(page, plant, "/")
        expect(page.locator(".alarm")).to_have_count(3)
        expect(page.locator("#verdict-word")).to_contain_text("L-2")
        screenshot(page, "alarms-tablet")
        for each in [*page.locator(".alarm").all(), page.locator("#verdict")]:
            box = each.bounding_box()
            assert box is not None and box["y"] + box["height"] <= SIZES["tablet"]["height"]
        assert page.evaluate("document.querySelector('#alarm-list').scrollTop") == 0
        watched.assert_clean()


@pytest.mark.full
def test_a_camera_with_a_fault_has_a_tile_as_high_as_the_others(
    browser: Browser, plant: DaemonProcess
) -> None:
    for size in VIEWPORTS.values():
        with watched_page(browser, viewport=size) as watched:
            page = watched.page
            show(page, plant, "/")
            page.locator('#camera-tiles li:not([data-ne107="good"])').first.wait_for()
            until(page, "() => document.querySelector('#camera-tiles .picture').style.backgroundImage !== ''")
            heights = page.evaluate(
                "[...document.querySelectorAll('#camera-tiles button')].map((each) => each.offsetHeight)"
            )
            assert max(heights) - min(heights) <= 1, heights


@pytest.mark.full
def test_the_call_to_sign_in_moves_nothing(browser: Browser, plant: DaemonProcess) -> None:
    with watched_page(browser, viewport=PHONE) as watched:
        page = watched.page
        show(page, plant, "/lots")
        before = page.locator("#list").bounding_box()
        page.evaluate("window.dispatchEvent(new Event('sign-in-needed'))")
        expect(page.locator(".banner.sign-in")).to_be_in_viewport()
        assert page.locator("#list").bounding_box() == before
        assert violations(page) == []
