"""The whole service below a path of nginx and Caddy with TLS, with the files that deploy/proxy has for them."""

import json
import re
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, expect
from support.browser import watched_page
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.proxies import NAME, PROXIES, Proxy, write_certificate

from service.store.keys import create_key
from service.web.routes.screens import PAGES
from service.web.settings import Scope

pytestmark = pytest.mark.full
PREFIX = "/stonefall"
PATIENCE_MS = 300_000
PRODUCT = {"title": "8/16", "density_kg_m3": 2850, "lower_mm": 8, "upper_mm": 16}
API = f"""[plant]
base_url = "https://{NAME}{PREFIX}"
[api]
path_prefix = "{PREFIX}"
allowed_hosts = ["{NAME}"]
trusted_proxies = ["127.0.0.1"]
"""


class Proxied:
    """A client of the proxy by name, without asking a name server."""

    def __init__(self, proxy: Proxy, token: str, certificate: Path) -> None:
        self.origin = f"https://{NAME}:{proxy.port}"
        self.port, self.reload, self.token, self.certificate = proxy.port, proxy.reload, token, certificate
        self._client = self.connected()

    def connected(self) -> httpx.Client:
        """Return a client that relies on the certificate as it is now."""
        return httpx.Client(
            base_url=f"https://127.0.0.1:{self.port}",
            verify=ssl.create_default_context(cafile=self.certificate),
            timeout=PATIENCE_MS / 1000,
        )

    def served(self) -> str:
        """Return the certificate that is served."""
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        with (
            socket.create_connection(("127.0.0.1", self.port)) as plain,
            context.wrap_socket(plain, server_hostname=NAME) as wrapped,
        ):
            return ssl.DER_cert_to_PEM_cert(wrapped.getpeercert(binary_form=True) or b"")

    def ask(self, method: str, path: str, **options: Any) -> httpx.Response:
        with self.stream(method, path, **options) as answer:
            answer.read()
            return answer

    def stream(self, method: str, path: str, **options: Any) -> Any:
        headers = {"Host": f"{NAME}:{self.port}", "Authorization": f"Bearer {self.token}"}
        headers |= options.pop("headers", {})
        self._client.cookies.clear()
        extensions = {"sni_hostname": NAME}
        return self._client.stream(method, path, headers=headers, extensions=extensions, **options)

    def rely_on_renewed(self) -> None:
        self._client.close()
        self._client = self.connected()

    def close(self) -> None:
        self._client.close()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[tuple[DaemonProcess, str]]:
    folder = tmp_path_factory.mktemp("daemon")
    _, token = create_key(folder / "state", "office", tuple(Scope), None, "root")
    daemon = DaemonProcess(folder, recording, rig="loop = true\nspeed = 0.5")
    daemon.config_path.write_text(daemon.config_path.read_text().replace("[api]\n", API))
    with daemon:
        daemon.hear("READY=1")
        yield daemon, token


@pytest.fixture(scope="module", params=PROXIES, ids=lambda proxy: proxy.__name__)
def proxied(
    daemon: tuple[DaemonProcess, str],
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Proxied]:
    process, token = daemon
    folder = tmp_path_factory.mktemp(request.param.__name__)
    with request.param(folder, urlsplit(process.url("")).port) as proxy:
        proxied = Proxied(proxy, token, folder / "stonefall.pem")
        yield proxied
        proxied.close()


def api(path: str) -> str:
    return f"{PREFIX}/api/v1{path}"


def newest_stone(proxied: Proxied) -> str:
    items = []
    while not items:
        items = proxied.ask("GET", api("/results?after=0&limit=1&wait_s=30")).json()["items"]
    return str(items[0]["id"])


def test_every_page_comes_to_life_and_writes(browser: Browser, proxied: Proxied) -> None:
    stone = newest_stone(proxied)
    home = proxied.origin + PREFIX
    expect.set_options(timeout=PATIENCE_MS)
    with watched_page(browser, ignore_https_errors=True) as watched:
        watched.is_expected = re.compile("status of 401")
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        page.goto(home)  # without the slash at its end
        page.locator(".banner.sign-in").get_by_role("link", name="Sign in").click()
        page.get_by_label("Token").fill(proxied.token)
        page.get_by_role("button", name="Sign in", exact=True).click()
        expect(page.locator("#ne107")).not_to_be_empty()  # the stream of overviews has come
        assert page.url == f"{home}/"
        (cookie,) = page.context.cookies()
        assert (cookie["name"], cookie["secure"], cookie["httpOnly"], cookie["sameSite"]) == (
            "__Host-stonefall-session-stonefall",
            True,
            True,
            "Strict",
        )
        for address in PAGES:
            page.goto(home + address.replace("{particle_id}", stone))
            expect(page.locator("#who")).to_contain_text("office")
            for link in page.locator("a[href]").evaluate_all("links => links.map(({ href }) => href)"):
                assert link.startswith(("data:", f"{home}/")), (address, link)
        page.goto(f"{home}/stones/{stone}")
        expect(page.locator("#numbers table")).to_be_visible()
        page.goto(f"{home}/lots")
        page.get_by_role("button", name="New product").click()
        dialog = page.get_by_role("dialog")
        values = {"Product": "by-page", "Name for people": "8/16", "Density of the particles": "2850"}
        for label, value in (values | {"d, mm": "8", "D, mm": "16"}).items():
            dialog.get_by_label(label, exact=label.endswith(" mm")).fill(value)
        dialog.get_by_label("Specification").select_option("astm-8")
        page.get_by_role("button", name="Save").click()
        expect(page.get_by_text("by-page, version 1, is saved")).to_be_visible()
        page.get_by_role("button", name="Close", exact=True).click()
        page.get_by_role("link", name="Stones", exact=True).click()
        expect(page).to_have_url(f"{home}/gallery")
        page.get_by_role("button", name="Sign out").click()
        expect(page.locator(".banner.sign-in")).to_be_visible()
        watched.assert_clean()


def test_a_page_of_another_origin_writes_nothing(proxied: Proxied) -> None:
    signed_in = proxied.ask(
        "POST", api("/session"), json={"token": proxied.token}, headers={"Origin": proxied.origin}
    )
    cookie = signed_in.headers["Set-Cookie"].partition(";")[0]
    for origin, status in (
        (proxied.origin, 200),
        (f"https://{NAME}:1", 403),
        (f"http://{NAME}:{proxied.port}", 403),
    ):
        headers = {"Cookie": cookie, "Origin": origin, "Authorization": ""}
        answer = proxied.ask("PUT", api("/products/by-cookie"), json=PRODUCT, headers=headers)
        assert answer.status_code == status, (origin, answer.text)


def test_streams_come_as_they_are_sent_and_long_polls_last(proxied: Proxied) -> None:
    for path in ("/results/stream?after=0", "/overview/stream"):
        with proxied.stream("GET", api(path)) as answer:
            assert answer.headers["Content-Type"].startswith("text/event-stream")
            events = (line for line in answer.iter_lines() if line.startswith("data:"))
            assert [json.loads(next(events).removeprefix("data:")) for _ in range(3)]
    last = proxied.ask("GET", api("/events?after=0&limit=1000")).json()["last_seq"]
    waited = proxied.ask("GET", api(f"/events?after={last}&limit=1000&wait_s=30"))
    assert waited.status_code == 200
    assert proxied.ask("GET", api("/results?after=0&limit=1&wait_s=30")).json()["items"]


def test_a_renewed_certificate_counts_after_a_reload_and_streams_go_on(proxied: Proxied) -> None:
    before = proxied.served()
    with proxied.stream("GET", api("/results/stream?after=0")) as answer:
        events = (line for line in answer.iter_lines() if line.startswith("data:"))
        next(events)
        write_certificate(proxied.certificate.parent)
        proxied.reload()
        eventually(lambda: proxied.served() != before)
        assert proxied.served().split() == proxied.certificate.read_text().split()
        assert [next(events) for _ in range(3)]
    proxied.rely_on_renewed()
    assert proxied.ask("GET", api("/health/ready")).status_code in (200, 503)


def test_what_is_made_is_where_location_says_and_reports_lead_back(proxied: Proxied) -> None:
    lot = f"L-{proxied.port}"
    assert proxied.ask("PUT", api("/products/basalt"), json=PRODUCT).status_code == 200
    opened = proxied.ask("POST", api("/lots"), json={"lot": lot, "product": "basalt"})
    assert opened.headers["Location"] == api(f"/lots/{lot}")
    assert proxied.ask("GET", opened.headers["Location"]).json()["lot"] == lot
    assert proxied.ask("POST", api(f"/lots/{lot}/close?wait_s=20"), json={}).status_code == 200
    report = proxied.ask("GET", api(f"/lots/{lot}/report.pdf"))
    assert report.content.startswith(b"%PDF")
    page = proxied.ask("GET", api(f"/lots/{lot}/report.html")).text
    address = re.search(rf"https://{NAME}(/[^\s<\"]+)", page)
    assert address is not None and proxied.ask("GET", address[1]).status_code == 200
    screen = proxied.ask("POST", api("/session/pairing")).json()
    assert screen["confirm_at"] == f"{proxied.origin}{PREFIX}/setup?code={screen['code']}#screens"
    servers = proxied.ask("GET", api("/openapi.json")).json()["servers"]
    assert [server["url"] for server in servers] == [PREFIX]


def test_a_body_too_large_is_refused_in_the_daemon_s_own_words(proxied: Proxied) -> None:
    answer = proxied.ask("PUT", api("/products/basalt"), json={"title": "x" * 3_000_000})
    assert (answer.status_code, answer.headers["Content-Type"]) == (413, "application/problem+json")


def test_what_a_client_claims_of_itself_is_not_believed(proxied: Proxied) -> None:
    headers = {"Authorization": "", "X-Forwarded-For": "", "X-Forwarded-Proto": "http"}
    answer = proxied.ask("GET", api("/session"), headers=headers)
    assert answer.json()["who"] is None  # not this machine
