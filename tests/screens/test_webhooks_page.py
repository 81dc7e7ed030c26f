"""Webhooks in the setup page: added, tested, sent again, given another secret and removed, by keys and in German."""

import json
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from support.browser import SIZES, Watched, origin_of, reachable_by_tab, screenshot, violations, watched_page
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.webhook_receiver import is_signed

from service.delivery.settings import key_of

PATIENCE_MS = 300_000


class Endpoint(HTTPServer):
    """Takes what is posted, or refuses it with `status`."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Taking)
        self.status = 204
        self.taken: list[tuple[dict[str, str], bytes]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/hook"


class Taking(BaseHTTPRequestHandler):
    server: Endpoint

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.taken.append(({name.lower(): value for name, value in self.headers.items()}, body))
        self.send_response(self.server.status)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def endpoint() -> Iterator[Endpoint]:
    with Endpoint() as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[DaemonProcess]:
    rig = 'pace = "fast"\n[webhooks]\nallowed_hosts = ["127.0.0.1"]'
    with DaemonProcess(tmp_path_factory.mktemp("daemon"), recording, rig=rig) as daemon:
        daemon.hear("READY=1")
        yield daemon
        assert daemon.process.poll() is None, daemon.log


@pytest.fixture
def page(watched: Watched, daemon: DaemonProcess) -> Page:
    watched.is_expected = re.compile("status of (404|422)")
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    watched.page.goto(f"{origin_of(daemon.url(''))}/setup#webhooks")
    return watched.page


def fill(page: Page, name: str, url: str, events: str = "") -> None:
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_label("Address").fill(url)
    page.get_by_label("Events").fill(events)
    page.get_by_role("button", name="Save").press("Enter")


def test_an_endpoint_from_its_secret_to_its_end(
    page: Page, daemon: DaemonProcess, endpoint: Endpoint
) -> None:
    expect(page.locator("#wizard")).to_contain_text("There is no endpoint yet.")
    fill(page, "erp", "http://elsewhere.example/x")
    expect(
        page.get_by_role("alert").filter(has_text="elsewhere.example is not in [webhooks] allowed_hosts")
    ).to_be_visible()
    fill(page, "erp", endpoint.url, "lot.opened, lot.closed")
    secret = page.locator("code.secret").inner_text()
    row = page.locator("#wizard tbody tr")
    expect(row).to_contain_text("lot.opened, lot.closed")
    screenshot(page, "setup-webhooks-secret")
    assert violations(page) == []

    page.get_by_role("button", name="Test erp").press("Enter")
    expect(page.locator(".verdict.good")).to_contain_text("erp took it: HTTP 204")
    headers, body = endpoint.taken[-1]
    assert is_signed(headers, body, key_of(secret))
    assert json.loads(body)["type"] == "webhook.test"

    daemon.put("/products/p", {"title": "p", "density_kg_m3": 2850})
    daemon.post("/lots", {"lot": "L1", "product": "p"})
    eventually(lambda: json.loads(endpoint.taken[-1][1])["type"] == "lot.opened")
    page.get_by_role("button", name="Send again erp").press("Enter")
    opened = json.loads(endpoint.taken[-1][1])["data"]["seq"]
    page.get_by_label("Number of the event").fill(str(opened))
    n_taken = len(endpoint.taken)
    page.get_by_role("button", name="Send", exact=True).press("Enter")
    eventually(lambda: len(endpoint.taken) == n_taken + 1)
    assert endpoint.taken[-1][0]["webhook-id"] == endpoint.taken[-2][0]["webhook-id"]
    expect(page.get_by_label("Number of the event")).to_have_count(0)

    page.get_by_role("button", name="New secret erp").press("Enter")
    expect(page.locator("code.secret")).to_be_visible()
    other = page.locator("code.secret").inner_text()
    page.get_by_role("button", name="Drop the old secret erp").press("Enter")
    expect(page.get_by_role("button", name="New secret erp")).to_be_visible()
    page.get_by_role("button", name="Test erp").press("Enter")
    eventually(lambda: is_signed(*endpoint.taken[-1], key_of(other)))
    assert not is_signed(*endpoint.taken[-1], key_of(secret))

    endpoint.status = 410
    daemon.post("/lots/L1/close", {})
    expect(row).to_contain_text("Disabled since")
    endpoint.status = 204
    page.get_by_role("button", name="Enable erp").press("Enter")
    expect(row).to_contain_text("Takes messages; 0 wait.")

    page.get_by_role("button", name="Remove erp").press("Enter")
    page.get_by_role("button", name="Really remove erp").press("Enter")
    expect(page.locator("#wizard")).to_contain_text("There is no endpoint yet.")


@pytest.mark.parametrize(
    ("size", "theme"), [("wall", "light"), pytest.param("tablet", "dark", marks=pytest.mark.full)]
)
def test_all_of_it_by_keyboard_in_german(
    browser: Browser, daemon: DaemonProcess, endpoint: Endpoint, size: str, theme: str
) -> None:
    daemon.put("/webhooks/mes", {"url": endpoint.url})
    with watched_page(browser, viewport=SIZES[size], locale="de-DE", color_scheme=theme) as watched:
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{origin_of(daemon.url(''))}/setup#webhooks")
        expect(page.get_by_role("button", name="Testen mes")).to_be_visible()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert violations(page) == []
        screenshot(page, f"setup-webhooks-{size}-{theme}")
        names = page.locator("main button:enabled").evaluate_all(
            "(all) => all.map((each) => each.getAttribute('aria-label') ?? each.innerText.trim())"
        )
        assert set(names) <= reachable_by_tab(page)
        watched.assert_clean()
