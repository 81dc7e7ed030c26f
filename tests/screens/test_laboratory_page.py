"""The laboratory's page on a running replay: a table is pasted, read back beside the instrument, and stored."""

import base64
import re
from collections.abc import Iterator
from io import BytesIO
from itertools import pairwise, product

import pytest
import xlsxwriter
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


@pytest.mark.full
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
    page.get_by_role("button", name="Read and compare").click()
    expect(page.locator("#entry p.problem")).to_contain_text(
        "Wert"
    )  # retained or passing, g or %: nothing is guessed

    table.fill(pasted(replay, lot, head=""))
    page.locator("select[name=head]").select_option("retained-g")
    page.get_by_text("File, dry mass").click()
    page.get_by_label("Dry mass before sieving").fill("1004")
    page.get_by_label("Sieved by").fill("A. Miller")
    page.get_by_role("button", name="Read and compare").click()
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
@pytest.mark.full
def test_the_page_is_accessible_at_all_sizes(
    browser: Browser, replay: DaemonProcess, lot: str, size: str, theme: str
) -> None:
    viewport = {**SIZES, "phone": PHONE}[size]
    with watched_page(browser, viewport=viewport, color_scheme=theme, locale="de-DE") as watched:
        page = watched.page
        page.goto(f"{origin_of(replay.url(''))}/laboratory?lot={lot}")
        page.get_by_label(re.compile("^Tabelle")).fill(pasted(replay, lot))
        page.get_by_role("button", name="Lesen und vergleichen").click()
        page.locator("#reading tbody tr").first.wait_for()
        screenshot(page, f"laboratory-{size}-{theme}")
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
        watched.assert_clean()


DROP = """([name, content]) => {
  const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([bytes], name));
  const place = document.querySelector("#entry textarea");
  place.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
}"""


def workbook(lines: list[list[str]]) -> str:
    """Two sheets in Base64, of which the first has the table as numbers."""
    out = BytesIO()
    with xlsxwriter.Workbook(out, {"in_memory": True, "strings_to_numbers": True}) as book:
        for name in ("Siebung", "Notizen"):
            sheet = book.add_worksheet(name)
            for number, line in enumerate(lines if name == "Siebung" else [["nothing"]]):
                sheet.write_row(number, 0, line)
    return base64.b64encode(out.getvalue()).decode()


@pytest.mark.full
def test_a_workbook_is_dropped_and_read_as_a_table(
    page: Page, watched: Watched, replay: DaemonProcess, lot: str
) -> None:
    watched.is_expected = re.compile("status of 422")
    page.goto(f"{origin_of(replay.url(''))}/laboratory?lot={lot}")
    text = page.locator("#entry textarea")
    text.wait_for()
    page.evaluate(DROP, ["damaged.xlsx", base64.b64encode(b"PK no workbook").decode()])
    expect(page.locator("#entry")).to_contain_text("cannot be unpacked")
    old = base64.b64encode("Sieb µm;Rückstand g\n16000;5".encode("cp1252")).decode()
    page.evaluate(DROP, ["sieving.csv", old])
    expect(text).to_have_value("Sieb µm;Rückstand g\n16000;5")
    lines = [line.replace(",", ".").split("\t") for line in pasted(replay, lot).splitlines()]
    page.evaluate(DROP, ["sieving.xlsx", workbook(lines)])
    expect(page.get_by_label("Sheet of the workbook")).to_be_visible()
    expect(text).to_have_value(re.compile("^Siebweite mm\tRückstand g\n"))
    page.get_by_role("button", name="Read and compare").click()
    expect(page.locator("#reading tbody tr")).to_have_count(len(SIEVES_MM))
    expect(page.locator("#reading")).to_contain_text("1,000.0 g")


def test_months_of_sievings_are_previewed_stored_and_compared(
    page: Page, watched: Watched, replay: DaemonProcess, lot: str
) -> None:
    curve = {
        step["sieve_mm"]: round(step["passing_percent"]["value"], 2)
        for step in replay.get(f"/lots/{lot}/gradation")["curve"]
        if step["sieve_mm"] in SIEVES_MM
    }
    head = ";".join(["Los", "Datum", *(f"Durchgang % {mm} mm" for mm in SIEVES_MM)])
    values = ";".join(str(curve[mm]).replace(".", ",") for mm in SIEVES_MM)
    table = f"{head}\n{lot};02.03.2026;{values}\n{lot};03.03.2026;{values}\nL-99;03.03.2026;{values}\n"
    page.goto(f"{origin_of(replay.url(''))}/laboratory?lot={lot}")
    page.locator("#history textarea").fill(table)
    page.get_by_role("button", name="Preview").click()
    found = page.locator("#history-found")
    expect(found).to_contain_text("2 sievings can be stored, 1 are refused.")
    expect(found.locator(".refused tbody tr")).to_have_text(re.compile("4.*L-99.*there is no lot"))
    with page.expect_download() as template:
        page.get_by_role("link", name="Template").click()
    assert template.value.suggested_filename == "sievings.csv"
    found.get_by_role("button", name="Store these").click()
    expect(found).to_contain_text("2 sievings are stored.")

    place = page.locator("#repeatability")
    place.locator("select[name=runs]").select_option([lot])
    place.locator("select[name=of]").select_option("laboratory")
    place.get_by_role("button", name="Compute").click()
    compared = page.locator("#repeatability-found")
    row = compared.locator("tbody tr").filter(has_text="Passing 16 mm")
    expect(row.locator("td").nth(3)).to_have_text("0.00")  # the same twice: s_r is 0
    with page.expect_download() as export:
        compared.get_by_role("link", name="Export as CSV").click()
    content = export.value.path().read_text(encoding="utf-8-sig")
    assert content.startswith('"figure","mean","n_runs"') and '"passing_16_mm_percent"' in content
