"""What somebody without a session sees, and how a key becomes one."""

import re
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Literal
from urllib.parse import urlencode

import pytest
from playwright.sync_api import Browser, expect
from support.browser import Watched, origin_of, screenshot, violations, watched_page
from support.daemon_process import DaemonProcess
from support.extents import first_quick

from service.store.keys import create_key, revoke_key
from service.web.settings import Scope

REFUSED = re.compile("status of 401")
PATIENCE_MS = 300_000
LEAST_CONTRAST = 4.5
"""Least contrast of text of usual size (WCAG 2.2, 1.4.3)."""
PHONE = {"width": 390, "height": 844}
CONTRASTS = """
(() => {
  const channels = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const light = (colour) => channels(colour).slice(0, 3).map((value) => value / 255)
    .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4))
    .reduce((sum, value, n) => sum + value * [0.2126, 0.7152, 0.0722][n], 0);
  const behind = (place) => {
    const colour = getComputedStyle(place).backgroundColor;
    return channels(colour)[3] === 0 ? behind(place.parentElement) : colour;
  };
  return Object.fromEntries([...document.querySelectorAll(".button, button, .banner strong")].map((place) => {
    const [dark, bright] = [light(getComputedStyle(place).color), light(behind(place))].sort((a, b) => a - b);
    return [`${place.className} ${place.textContent}`, (bright + 0.05) / (dark + 0.05)];
  }));
})()
"""
"""Contrast of each button's words with what is behind them, by WCAG 2.2, as the browser computed both."""


@pytest.fixture
def locked(tmp_path: Path, recording: Path) -> Iterator[tuple[DaemonProcess, str]]:
    """A daemon that has a key, and the key's token."""
    _, token = create_key(tmp_path / "state", "shift", (Scope.READ, Scope.OPERATE), None, "root")
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0") as daemon:
        daemon.hear("READY=1")
        yield daemon, token


def test_a_key_becomes_a_session_and_the_page_comes_to_life(
    watched: Watched, locked: tuple[DaemonProcess, str]
) -> None:
    daemon, token = locked
    watched.is_expected = REFUSED
    page = watched.page
    expect.set_options(timeout=PATIENCE_MS)
    page.goto(origin_of(daemon.url("")))
    expect(page.locator("#ne107")).to_be_empty()
    page.locator(".banner.sign-in").get_by_role("link", name="Sign in").click()
    page.get_by_label("Token").fill("not a token")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_contain_text("no such key")
    page.get_by_label("Token").fill(token)
    page.get_by_role("button", name="Sign in").click()
    expect(page.locator("#ne107")).not_to_be_empty()
    expect(page.locator("#who")).to_contain_text("shift")
    assert token not in page.content() and token not in page.url
    assert page.evaluate("document.cookie") == ""  # no script sees the session
    page.get_by_role("button", name="Sign out").click()
    expect(page.locator(".banner.sign-in")).to_be_visible()


@pytest.mark.full
def test_a_sign_in_leads_to_no_other_host(watched: Watched, locked: tuple[DaemonProcess, str]) -> None:
    daemon, token = locked
    watched.is_expected = re.compile("status of 40[14]")  # there is no such page
    page = watched.page
    expect.set_options(timeout=PATIENCE_MS)
    for address in ("/.//elsewhere.example/", "//elsewhere.example/", "javascript:alert(1)"):
        page.context.clear_cookies()
        page.goto(f"{origin_of(daemon.url(''))}/sign-in?{urlencode({'next': address})}")
        page.get_by_label("Token").fill(token)
        page.get_by_role("button", name="Sign in").click()
        page.wait_for_url(lambda url: "/sign-in" not in url)
        assert origin_of(page.url) == origin_of(daemon.url(""))


@pytest.mark.parametrize(
    ("theme", "path"),
    first_quick(
        product(("light", "dark"), ("", "/sign-in#pair", "/lots?language=de", "/sign-in?language=de#pair"))
    ),
)
@pytest.mark.full
def test_a_signed_out_page_can_be_read_and_fits_a_phone(
    browser: Browser, locked: tuple[DaemonProcess, str], theme: Literal["light", "dark"], path: str
) -> None:
    daemon, _ = locked
    expect.set_options(timeout=PATIENCE_MS)
    with watched_page(browser, viewport=PHONE, color_scheme=theme) as watched:
        watched.is_expected = REFUSED
        page = watched.page
        page.goto(origin_of(daemon.url("")) + path)
        if "sign-in" in path:
            expect(page.locator("#code output")).to_have_text(re.compile(r"\d{3} \d{3}"))
        else:
            expect(page.locator(".banner.sign-in .button")).to_have_count(2)
        contrasts = page.evaluate(CONTRASTS)
        assert len(contrasts) >= 2
        assert min(contrasts.values()) >= LEAST_CONTRAST, contrasts
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        assert violations(page) == []
        screenshot(page, f"signed-out-{theme}-{re.sub('[^a-z]+', '-', path)}")
        watched.assert_clean()


@pytest.mark.full
def test_a_wall_screen_is_paired_by_its_code_and_only_reads_until_its_key_is_revoked(
    browser: Browser, watched: Watched, locked: tuple[DaemonProcess, str]
) -> None:
    daemon, _ = locked
    home = origin_of(daemon.url(""))
    state_dir = daemon.folder / "state"
    _, boss = create_key(state_dir, "boss", tuple(Scope), None, "root")
    expect.set_options(timeout=PATIENCE_MS)
    watched.is_expected = re.compile("status of 40[13]")
    wall = watched.page
    wall.goto(f"{home}/lots")
    wall.locator(".banner.sign-in").get_by_role("link", name="Pair this screen").click()
    code = wall.get_by_label("Code of this screen")
    expect(code).to_be_visible()  # its text is empty until the page is painted
    shown = code.inner_text()
    with watched_page(browser, extra_http_headers={"Authorization": f"Bearer {boss}"}) as other:
        tablet = other.page
        tablet.goto(f"{home}/setup#screens")
        tablet.get_by_label("Code").fill("000000" if shown != "000 000" else "000001")
        tablet.get_by_role("button", name="Find the screen").click()
        expect(tablet.get_by_role("alert")).to_contain_text("no screen shows this code")
        other.is_expected = re.compile("status of 404")
        tablet.get_by_label("Code").fill(shown)
        tablet.get_by_role("button", name="Find the screen").click()
        expect(tablet.get_by_text("127.0.0.1")).to_be_visible()
        expect(tablet.get_by_text("Chrom")).to_be_visible()
        tablet.get_by_label("Name of the screen").fill("silo-2")
        tablet.get_by_role("button", name="Confirm").click()
        expect(tablet.get_by_text("silo-2 signs itself in")).to_be_visible()
        other.assert_clean()
    expect(wall.locator("#who")).to_contain_text("silo-2")  # by itself
    assert wall.url == f"{home}/lots"
    refused = wall.evaluate(
        "fetch('/api/v1/acquisition', {method: 'PUT', headers: {'Content-Type': 'application/json'},"
        ' body: \'{"state": "disarmed"}\'}).then((answer) => answer.json())'
    )
    assert (refused["status"], refused["detail"]) == (
        403,
        "key 'silo-2' is a display's, which may only read: sign in with another key",
    )
    (cookie,) = wall.context.cookies()
    assert cookie["expires"] > time.time() + 300 * 24 * 3600
    revoke_key(state_dir, "silo-2", "root")
    wall.reload()
    expect(wall.locator(".banner.sign-in")).to_be_visible()


@pytest.mark.full
def test_the_first_key_is_made_by_a_page_that_says_who_is_shut_out(
    watched: Watched, tmp_path: Path, recording: Path
) -> None:
    expect.set_options(timeout=PATIENCE_MS)
    watched.is_expected = re.compile("status of 401")
    page = watched.page
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        code = daemon.post("/session/pairing", {})["code"]
        page.goto(
            f"{origin_of(daemon.url(''))}/setup?language=de&code={code}#screens"
        )  # as the QR code leads
        expect(page.get_by_text("Damit entsteht der erste Schlüssel.")).to_be_visible()
        expect(page.locator("li", has_text="Chrome")).to_have_count(1)
        assert violations(page) == []
        screenshot(page, "first-key")
        page.get_by_label("Name des Bildschirms").fill("leitstand")
        page.get_by_role("button", name="Bestätigen").click()
        expect(page.get_by_text("leitstand meldet sich in wenigen Sekunden selbst an.")).to_be_visible()
        page.reload()
        expect(page.locator(".banner.sign-in")).to_contain_text("Bildschirm koppeln")
