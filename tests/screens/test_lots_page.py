"""The page of the lots on a running replay: a shift's work with lots and products by hand."""

import re
from collections.abc import Iterator
from itertools import product

import pytest
from playwright.sync_api import Browser, Page, expect
from support.browser import SIZES, Watched, origin_of, screenshot, violations, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick

PATIENCE_MS = 60_000
PRODUCT = {
    "title": "8/16 basalt",
    "density_kg_m3": 2850,
    "lower_mm": 8,
    "upper_mm": 16,
    "specification": "astm-8",
}
PHONE = {"width": 390, "height": 844}


@pytest.fixture
def page(watched: Watched) -> Iterator[Page]:
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    yield watched.page


def shown(page: Page, replay: DaemonProcess, path: str = "/lots") -> Page:
    page.goto(origin_of(replay.url("")) + path)
    expect(page.get_by_role("heading", name="Lots", exact=True)).to_be_visible()
    return page


def row_of(page: Page, name: str) -> str:
    return page.locator("#list tr", has=page.get_by_role("link", name=name, exact=True)).inner_text()


def test_a_shift_s_lots_are_worked_with_on_the_page_alone(page: Page, replay: DaemonProcess) -> None:
    shown(page, replay)
    expect(page.get_by_text("define one first")).to_be_visible()
    page.get_by_role("button", name="New product").click()
    for label, value in (
        ("Product", "basalt-8-16"),
        ("Name for people", "8/16 basalt"),
        ("Density of the particles", "2850"),
        ("d, mm", "8"),
        ("D, mm", "16"),
    ):
        page.get_by_role("dialog").get_by_label(label, exact=label in ("d, mm", "D, mm")).fill(value)
    page.get_by_role("dialog").get_by_label("Specification").select_option("astm-8")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("basalt-8-16, version 1, is saved")).to_be_visible()
    page.get_by_role("button", name="Close", exact=True).click()

    form = page.locator("#open-lot form")
    form.get_by_label(re.compile("^Lot")).fill("L-7")
    form.get_by_text("More about the lot").click()
    form.get_by_label("Customer").fill("Straßenbau Süd")
    form.get_by_label(re.compile("^Lot")).press("Enter")  # as a scanner ends a code
    expect(page.locator("#open-lot strong")).to_have_text("L-7")
    n_stones = page.locator("#open-lot .stones")
    expect(n_stones).not_to_have_text("0")

    page.get_by_role("button", name="Close …").click()
    page.get_by_label(re.compile("Mass of the whole lot")).fill("21.5")
    page.get_by_role("button", name="Close the lot").click()
    done = page.get_by_role("dialog", name="Lot L-7 is closed")
    expect(done).to_be_visible()
    final = replay.get("/lots/L-7")
    assert (final["state"], final["tonnage_t"], final["customer"]) == ("closed", 21.5, "Straßenbau Süd")
    words = {"conforms": "conforms", "does_not_conform": "does not conform"}
    verdict = final["completion"]["verdict"]
    expect(done.locator("p.verdict")).to_contain_text(words.get(verdict, ""))
    issued = done.get_by_role("link", name="PDF").get_attribute("href")
    assert issued == final["completion"]["report"]
    answer = page.request.get(origin_of(replay.url("")) + issued)
    assert (answer.status, answer.body()[:4]) == (200, b"%PDF")
    page.get_by_role("button", name="Close", exact=True).click()

    expect(page.locator("#open-lot form")).to_be_visible()  # for the next one
    page.get_by_label(re.compile("^Search")).fill("straßenbau")
    expect(page.locator("#list tbody tr")).to_have_count(1)
    page.get_by_label(re.compile("^Search")).fill("no such lot")
    expect(page.get_by_text("No lot fits.")).to_be_visible()
    page.get_by_label(re.compile("^Search")).fill("")

    page.get_by_role("button", name="Assign stones").click()
    dialog = page.get_by_role("dialog", name="Assign stones to lot L-7")
    dialog.get_by_label("From").fill("2000-01-01T00:00")
    dialog.get_by_label("To").fill("2000-01-02T00:00")
    dialog.get_by_role("button", name="Assign stones").click()
    expect(dialog.get_by_text("0 stones are in lot L-7 now")).to_be_visible()
    dialog.get_by_role("button", name="Close").click()

    page.get_by_role("button", name="Declare void").click()
    dialog = page.get_by_role("dialog", name="Declare void")
    dialog.get_by_label("Reason").fill("wrong belt")
    dialog.get_by_role("button", name="Declare void").click()
    expect(page.get_by_text("void: wrong belt")).to_be_visible()
    assert replay.get("/lots/L-7")["void_reason"] == "wrong belt"


@pytest.mark.full
def test_a_product_is_changed_once_its_differences_were_seen(page: Page, replay: DaemonProcess) -> None:
    own = {"name": "own limits", "passing": {"8": [0, 20], "16": [90, 100]}}
    replay.put("/products/own", {**PRODUCT, "title": "own", "specification": own, "sieve_set": [4, 8, 16]})
    shown(page, replay)
    page.locator("#products tr", has_text="own").get_by_role("button", name="Change").click()
    density = page.get_by_label("Density of the particles")
    density.fill("2900")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("2,850 → 2,900")).to_be_visible()
    assert replay.get("/products/own")["version"] == 1  # shown, not saved
    density.fill("2910")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("2,850 → 2,910")).to_be_visible()  # other differences are to be seen first, too
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("own, version 2, is saved")).to_be_visible()
    saved = replay.get("/products/own")
    assert (saved["density_kg_m3"], saved["specification"]["passing"], saved["sieve_set"]) == (
        2910,
        own["passing"],
        [4, 8, 16],
    )


@pytest.mark.full
def test_a_refusal_is_said_where_it_happened_and_the_form_keeps_its_words(
    page: Page, watched: Watched, replay: DaemonProcess
) -> None:
    watched.is_expected = re.compile("status of 422")
    replay.put("/products/basalt-8-16", PRODUCT)
    shown(page, replay)
    name = page.locator("#open-lot form").get_by_label(re.compile("^Lot"))
    name.fill("Los 12")
    page.get_by_role("button", name="Open the lot").click()
    expect(page.locator("#open-lot .problem")).to_contain_text("external_id")
    expect(name).to_have_value("Los 12")
    assert replay.get("/lots?state=open")["items"] == []


@pytest.mark.full
def test_a_code_scanned_beside_all_fields_opens_a_lot_of_the_product_before(
    page: Page, replay: DaemonProcess
) -> None:
    for name in ("another", "basalt-8-16"):
        replay.put(f"/products/{name}", PRODUCT)
    replay.post("/lots", {"lot": "L-20", "product": "basalt-8-16"})
    replay.post("/lots/L-20/close", {})
    shown(page, replay)
    expect(page.get_by_text("Scan a code")).to_be_visible()
    page.keyboard.type("L-21")
    page.keyboard.press("Enter")
    expect(page.locator("#open-lot strong")).to_have_text("L-21")
    assert replay.get("/lots/L-21")["product"] == "basalt-8-16"
    page.get_by_role("button", name="Change product …").click()
    page.keyboard.type("L-22")
    page.keyboard.press("Enter")
    expect(page.locator("#open-lot strong")).to_have_text("L-22")
    assert replay.get("/lots/L-22")["product"] != "basalt-8-16"
    replay.post("/lots/L-22/close", {})


@pytest.mark.parametrize(("size", "theme"), first_quick(product([*SIZES, "phone"], ("light", "dark"))))
@pytest.mark.full
def test_the_page_is_accessible_at_all_sizes(
    browser: Browser, replay: DaemonProcess, size: str, theme: str
) -> None:
    replay.put("/products/basalt-8-16", PRODUCT)
    viewport = {**SIZES, "phone": PHONE}[size]
    with watched_page(browser, viewport=viewport, color_scheme=theme, locale="de-DE") as watched:
        page = watched.page
        page.goto(origin_of(replay.url("")) + "/lots")
        page.locator("#list tbody tr, #list p").first.wait_for()
        screenshot(page, f"lots-{size}-{theme}")
        assert violations(page) == []
        page.get_by_role("button", name="Ändern").first.click()
        screenshot(page, f"lots-product-{size}-{theme}")
        assert violations(page) == []
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= viewport["width"]
        watched.assert_clean()
