"""Pages on paper: the operator's page and the sheet of a shift are one sheet of A4 each, and not blank."""

import os
from io import BytesIO
from itertools import product
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from pypdf import PdfReader
from support.browser import SIZES, Watched, origin_of, screenshot, until, violations, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick
from typer.testing import CliRunner

from screens.test_lots_page import PHONE
from service.commands.cli import build_app

PATIENCE_MS = 60_000
A4_MM = (210, 297)
MM_A_POINT = 25.4 / 72


def printed(page: Page, name: str) -> tuple[str, int, tuple[int, int]]:
    """Print a page as a browser does; return its text, the number of pictures on it, and its size in mm."""
    content = page.pdf(format="A4", prefer_css_page_size=True)
    if folder := os.environ.get("STONEFALL_SCREENSHOTS"):
        (Path(folder) / f"{name}.pdf").write_bytes(content)
    (sheet,) = PdfReader(BytesIO(content)).pages
    size = sorted(round(float(each) * MM_A_POINT) for each in (sheet.mediabox.width, sheet.mediabox.height))
    return sheet.extract_text(), len(sheet.images), (size[0], size[1])


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.full
def test_the_operator_s_page_is_one_sheet_with_cameras_and_stones(
    browser: Browser, replay: DaemonProcess, theme: str
) -> None:
    with watched_page(browser, color_scheme=theme, locale="de-DE") as watched:
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        page.goto(origin_of(replay.url("")))
        page.locator("#newest img").nth(3).wait_for(timeout=PATIENCE_MS)
        page.locator("#curve-drawing svg").wait_for()
        until(page, "() => document.querySelector('#camera-tiles .picture').style.backgroundImage !== ''")
        until(
            page,
            "() => [...document.querySelectorAll('#newest img')].filter((img) => img.complete).length > 3",
        )
        text, n_pictures, size_mm = printed(page, f"operator-{theme}")
        assert size_mm == A4_MM
        assert "Aufzeichnung" in text or "Simul" in text
        assert "202" in text and "c16" not in text.split("Alarm")[0]
        assert n_pictures >= 5  # stones, and the sheet that all tiles are cut from
        watched.assert_clean()


def test_a_shift_is_chosen_shown_and_printed_on_one_sheet(watched: Watched, replay: DaemonProcess) -> None:
    page = watched.page
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    replay.wait_for("/accounting", lambda found: found["measured"] > 3)
    page.goto(origin_of(replay.url("")))
    page.get_by_role("link", name="Shift sheet").click()
    sheet = page.locator("#sheet")
    expect(sheet.get_by_role("heading", level=1)).to_contain_text("Shift of")
    expect(sheet).to_contain_text("PRELIMINARY")
    text, _, size_mm = printed(page, "shift")
    assert size_mm == A4_MM
    assert "Shift of" in text and "Times without a stone" in text and "Print" not in text
    first = page.locator("#shifts option").nth(1).get_attribute("value")
    page.locator("#shifts").select_option(first)
    expect(sheet).not_to_contain_text("PRELIMINARY")
    assert page.url.endswith(f"?shift={first}")
    assert f"/shifts/{first}/sheet.pdf" in (
        page.get_by_role("link", name="As PDF").get_attribute("href") or ""
    )


@pytest.mark.parametrize(("size", "theme"), first_quick(product([*SIZES, "phone"], ("light", "dark"))))
@pytest.mark.full
def test_the_sheet_is_accessible_at_all_sizes(
    browser: Browser, replay: DaemonProcess, size: str, theme: str
) -> None:
    viewport = {**SIZES, "phone": PHONE}[size]
    with watched_page(browser, viewport=viewport, color_scheme=theme, locale="de-DE") as watched:
        page = watched.page
        page.goto(f"{origin_of(replay.url(''))}/shift")
        page.locator("#sheet h1").wait_for()
        screenshot(page, f"shift-{size}-{theme}")
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
        watched.assert_clean()


def test_the_command_fetches_the_sheet_of_the_last_shift(replay: DaemonProcess, tmp_path: Path) -> None:
    url = origin_of(replay.url(""))
    words = ["report", "--shift", "last", "--out", str(tmp_path), "--url", url, "--language", "de"]
    done = CliRunner().invoke(build_app(["report"]), words)
    assert done.exit_code == 0, done.output
    name = replay.get("/shifts?limit=2")["items"][1]["shift"]
    assert {path.name for path in tmp_path.iterdir()} == {f"shift-{name}.html", f"shift-{name}.pdf"}
    assert "Schichtblatt" in (tmp_path / f"shift-{name}.html").read_text(encoding="utf-8")
    assert CliRunner().invoke(build_app(["report"]), ["report", "--shift", "last"]).exit_code != 0
