"""What somebody without a session sees, and how a key becomes one."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect
from support.browser import Watched, origin_of
from support.daemon_process import DaemonProcess

from service.store.keys import create_key
from service.web.settings import Scope

REFUSED = re.compile("status of 401")
PATIENCE_MS = 300_000


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
