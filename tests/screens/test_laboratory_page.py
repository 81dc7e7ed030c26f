"""The laboratory's page on a running replay: a table is pasted, read back beside the instrument, and stored."""

import re
from collections.abc import Iterator
from itertools import pairwise, product

import pytest
from playwright.sync_api import Browser, Page, expect
from support.browser import SIZES, Watched, origin_of, screenshot, violations, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick

from screens.test_lots_page import PHONE, PRODUCT

PATIENCE_MS = 60_000
SIEVES_MM = (8, 11.2, 16, 22.4)


@pytest.fixture
def page(watched: Watched) -> Iterator[Page]:
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    yield watched.page


@pytest.fixture(scope="module")
def lot(replay: DaemonProcess) -> str:
    """A closed lot with a few stones."""
    replay.put("/products/basalt-8-16", {**PRODUCT, "sieve_set": SIEVES_MM})
    replay.post("/lots", {"lot": "L-9", "product": "basalt-8-16"})
    replay.wait_for("/lots/L-9", lambda found: found["n_stones"] > 5)
    replay.post("/lots/L-9/close?wait_s=60", {})
    return "L-9"


def pasted(replay: DaemonProcess, lot: str, head: str = "Siebweite mm\tRückstand g\n") -> str:
    """A kilogram as the instrument would have sieved it, as a German spreadsheet copies it."""
    curve = {
        step["sieve_mm"]: step["passing_percent"]["value"]
        for step in replay.get(f"/lots/{lot}/gradation")["curve"]
    }
    passing = [0.0, *(curve[each] for each in SIEVES_MM), 100.0]
    grams = [f"{10 * (above - below):.2f}".replace(".", ",") for below, above in pairwise(passing)]
    pan, *retained = grams
    lines = [f"{str(mm).replace('.', ',')}\t{each}" for mm, each in zip(SIEVES_MM, retained, strict=True)]
    return head + "\n".join([*reversed(lines), f"Schale\t{pan}"])


def test_a_table_is_read_back_beside_the_instrument_before_it_is_stored(
    page: Page, watched: Watched, replay: DaemonProcess, lot: str
) -> None:
    watched.is_expected = re.compile("status of 422")
    page.goto(origin_of(replay.url("")) + "/lots")
    page.locator("#list tbody tr").first.wait_for()  # what comes late moves the link under the mouse
    page.get_by_role("link", name="Laboratory").click()
    page.locator("select[name=lot]").select_option(lot)
    table = page.get_by_label(re.compile("^Table"))
    table.fill(pasted(replay, lot, head="Siebweite mm\tWert\n"))
    page.get_by_role("button", name="Read it back").click()
    expect(page.locator("#entry .problem")).to_contain_text(
        "Wert"
    )  # retained or passing, g or %: nothing is guessed

    table.fill(pasted(replay, lot, head=""))
    page.locator("select[name=head]").select_option("retained-g")
    page.get_by_label("Dry mass before sieving").fill("1004")
    page.get_by_label("Sieved by").fill("A. Miller")
    page.get_by_role("button", name="Read it back").click()
    reading = page.locator("#reading")
    expect(reading.locator("tbody tr")).to_have_count(len(SIEVES_MM))
    expect(reading).to_contain_text("Sum of the fractions: 1,000.0 g")
    expect(reading).to_contain_text("Lost while sieving: 0.40 %")
    differences = reading.locator("tbody tr td:last-child").all_inner_texts()
    assert {each.replace("-", "") for each in differences} == {"0.0"}
    assert replay.get(f"/lots/{lot}/sieving")["items"] == []  # read, not stored

    page.get_by_role("button", name="Store").click()
    expect(reading).to_contain_text("The sieving of lot L-9 is stored.")
    (stored,) = replay.get(f"/lots/{lot}/sieving")["items"]
    assert (stored["by"], stored["dry_mass_g"], stored["mass_g"]) == (
        "A. Miller",
        1004.0,
        pytest.approx(1000, abs=0.1),
    )

    page.locator("#sievings tbody tr").get_by_role("button", name="Declare void").click()
    dialog = page.get_by_role("dialog", name="Declare void")
    dialog.get_by_label("Reason").fill("another portion")
    dialog.get_by_role("button", name="Declare void").click()
    expect(page.locator("#sievings")).to_contain_text("void: another portion")


def test_a_study_that_cannot_be_made_says_why(
    page: Page, watched: Watched, replay: DaemonProcess, lot: str
) -> None:
    watched.is_expected = re.compile("status of 4(09|22)")
    replay.post(f"/lots/{lot}/sieving", {"table": pasted(replay, lot)})
    page.goto(f"{origin_of(replay.url(''))}/laboratory?lot={lot}")
    expect(page.locator("#studies")).to_have_text("No study of this product yet.")
    page.get_by_role("button", name="Make a study").click()
    expect(page.locator("#study .problem")).to_contain_text("lot")


@pytest.mark.parametrize(("size", "theme"), first_quick(product([*SIZES, "phone"], ("light", "dark"))))
def test_the_page_is_accessible_at_all_sizes(
    browser: Browser, replay: DaemonProcess, lot: str, size: str, theme: str
) -> None:
    viewport = {**SIZES, "phone": PHONE}[size]
    with watched_page(browser, viewport=viewport, color_scheme=theme, locale="de-DE") as watched:
        page = watched.page
        page.goto(f"{origin_of(replay.url(''))}/laboratory?lot={lot}")
        page.get_by_label(re.compile("^Tabelle")).fill(pasted(replay, lot))
        page.get_by_role("button", name="Zurücklesen").click()
        page.locator("#reading tbody tr").first.wait_for()
        screenshot(page, f"laboratory-{size}-{theme}")
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
        watched.assert_clean()
