"""The operator's page while nobody answers: it says since when, goes on, and loads itself anew after an upgrade."""

import re
import signal
from pathlib import Path

import pytest
from playwright.sync_api import Route, expect
from support.browser import Watched, origin_of, until
from support.daemon_process import DaemonProcess, free_port

PATIENCE_MS = 300_000
REFUSED = re.compile(
    "ERR_CONNECTION_REFUSED|ERR_CONNECTION_RESET|ERR_INCOMPLETE|ERR_EMPTY_RESPONSE|ERR_TIMED_OUT"
)
"""What the browser says of a host on which nobody listens."""
LOOP = "loop = true\nspeed = 2.0"


@pytest.mark.full
def test_an_outage_is_told_and_an_upgrade_loads_the_page_anew(
    watched: Watched, recording: Path, tmp_path: Path
) -> None:
    watched.is_expected = REFUSED
    page, port = watched.page, free_port()
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    outage = page.locator(".banner.connection")
    with DaemonProcess(tmp_path, recording, rig=LOOP, slots=1, port=port) as daemon:
        daemon.hear("READY=1")
        home = origin_of(daemon.url("")) + "/"
        page.goto(home)
        expect(page.locator("#newest li")).not_to_have_count(0)
        expect(outage).to_have_count(0)
        daemon.stop(signal.SIGKILL)
        expect(outage).to_contain_text("No connection since")

    def answer(route: Route) -> None:
        """Answer as the next release would: its scripts have other addresses."""
        if route.request.is_navigation_request():
            route.continue_()
            return
        whole = route.fetch()
        route.fulfill(response=whole, body=re.sub(r"/screens/[0-9a-f]+/", "/screens/0000/", whole.text()))

    page.route(home, answer)
    with DaemonProcess(tmp_path, recording, rig=LOOP, slots=1, port=port) as daemon:
        with page.expect_event("load"):
            daemon.hear("READY=1")
        expect(outage).to_have_count(0)
        known = page.locator("[data-seq]").first.get_attribute("data-seq")
        until(page, "(known) => document.querySelector('[data-seq]')?.dataset.seq !== known", known)
