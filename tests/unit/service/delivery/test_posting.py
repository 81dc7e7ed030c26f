"""One request to an endpoint: every status, and other sides that are slow, silent or hostile."""

import asyncio
import socket
import ssl
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from support.eventually import PATIENCE_S
from support.webhook_receiver import CERTIFICATE, NEVER, SECRET, Receiver, answer

from service.delivery.posting import MAX_HEAD_BYTES, post
from service.delivery.progress import EndpointAnswer
from service.delivery.settings import WebhookEndpoint, WebhooksSettings

LOOPBACK = ("127.0.0.0/8",)


def settings_of(url: str, hosts: tuple[str, ...] = ("127.0.0.1",), **more: Any) -> WebhooksSettings:
    endpoint = WebhookEndpoint(
        name="mes", url=url, secrets=(SecretStr(SECRET),), ca_file=more.pop("ca_file", None)
    )
    return WebhooksSettings(allowed_hosts=hosts, endpoints=(endpoint,), **more)


async def ask(settings: WebhooksSettings, body: bytes = b"{}") -> EndpointAnswer:
    (endpoint,) = settings.endpoints
    headers = {"webhook-id": "event-1", "webhook-timestamp": "1", "webhook-signature": "v1,x"}
    return await post(endpoint, settings, body, headers, endpoint.tls())


async def ask_receiver(receiver: Receiver, **more: Any) -> EndpointAnswer:
    return await ask(settings_of(f"http://127.0.0.1:{receiver.port}/hook?site=3", **more))


async def test_the_request_is_one_that_every_server_reads() -> None:
    async with Receiver() as receiver:
        assert (await ask_receiver(receiver)).problem is None
        (request,) = receiver.requests
        assert request.line == "POST /hook?site=3 HTTP/1.1"
        assert request.headers == {
            "Host": f"127.0.0.1:{receiver.port}",
            "Content-Type": "application/json",
            "Content-Length": "2",
            "User-Agent": "stonefall",
            "Connection": "close",
            "webhook-id": "event-1",
            "webhook-timestamp": "1",
            "webhook-signature": "v1,x",
        }


@pytest.mark.parametrize("status", [*range(200, 207), 299])
async def test_2xx_is_taken(status: int) -> None:
    async with Receiver([answer(status)]) as receiver:
        found = await ask_receiver(receiver)
    assert (found.status, found.problem) == (status, None)


@pytest.mark.parametrize("status", [301, 304, 400, 401, 404, 410, 418, 429, 500, 503, 599, 999])
async def test_everything_else_is_a_failure_that_names_the_status(status: int) -> None:
    async with Receiver([answer(status)]) as receiver:
        found = await ask_receiver(receiver)
    assert found.status == status
    assert (found.problem or "").startswith(f"HTTP {status}")


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
async def test_redirects_are_not_followed(status: int) -> None:
    async with Receiver() as other:
        location = f"http://127.0.0.1:{other.port}/"
        async with Receiver([answer(status, Location=location)]) as receiver:
            found = await ask_receiver(receiver)
        assert "redirects are not followed" in (found.problem or "")
        assert (found.status, other.n_connections) == (status, 0)


async def test_an_answer_may_come_after_informational_ones() -> None:
    async with Receiver(
        [b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 103 Early\r\n\r\n" + answer(202)]
    ) as receiver:
        assert (await ask_receiver(receiver)).status == 202


@pytest.mark.parametrize(
    ("header", "seconds"),
    [("120", 120.0), ("0", 0.0), ("soon", None), ("-1", None), ("9" * 30, None), ("", None)],
)
async def test_retry_after_in_seconds(header: str, seconds: float | None) -> None:
    async with Receiver([answer(429, Retry_After=header)]) as receiver:
        assert (await ask_receiver(receiver)).retry_after_s == seconds


async def test_retry_after_as_a_date() -> None:
    async with Receiver([answer(503, Retry_After="Wed, 01 Jan 2200 00:00:00 GMT")]) as receiver:
        assert ((await ask_receiver(receiver)).retry_after_s or 0) > 86_400


async def test_one_that_never_answers_is_given_up() -> None:
    async with Receiver([NEVER]) as receiver:
        found = await ask_receiver(receiver, timeout_s=0.1)
        assert (found.status, found.problem) == (None, "no answer within 0.1 s")


async def test_one_that_drips_its_head_is_given_up_in_the_same_time() -> None:
    async def drip(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while not writer.is_closing():
                writer.write(b"H")
                await writer.drain()
                await asyncio.sleep(0.02)

    async with await asyncio.start_server(drip, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        found = await ask(settings_of(f"http://127.0.0.1:{port}/", timeout_s=0.1))
        await asyncio.sleep(0.1)
    assert found.status is None
    assert found.problem


async def test_an_endless_body_is_not_read() -> None:
    head = b"HTTP/1.1 200 OK\r\n\r\n"
    async with Receiver([head], endless=b"x" * 65_536) as receiver:
        assert (await ask_receiver(receiver)).problem is None
        await receiver.until(lambda: receiver.n_refused == 1)


@pytest.mark.parametrize(
    "endless", [b"X-Filler: " + b"x" * 1000 + b"\r\n", b"x" * 4096, b"HTTP/1.1 102 Wait\r\n\r\n" * 100]
)
async def test_an_endless_head_is_refused_soon(endless: bytes) -> None:
    head = b"" if endless.startswith(b"HTTP") else b"HTTP/1.1 200 OK\r\n"
    async with Receiver([head or b"HTTP/1.1 102 Wait\r\n\r\n"], endless=endless) as receiver:
        found = await ask_receiver(receiver)
        await receiver.until(lambda: receiver.n_refused == 1)
    assert found.status is None
    assert f"longer than {MAX_HEAD_BYTES}" in (found.problem or "") or "not HTTP" in (found.problem or "")


@pytest.mark.parametrize("given", [b"\x00\xff\x00", b"SSH-2.0-OpenSSH\r\n\r\n", b"HTTP/1.1 abc\r\n\r\n"])
async def test_what_is_not_http_is_a_failure(given: bytes) -> None:
    async with Receiver([given], endless=b"\r\n" * 4096) as receiver:
        found = await ask_receiver(receiver)
    assert "not HTTP" in (found.problem or "")


async def test_a_closed_port_is_a_failure() -> None:
    async with Receiver() as receiver:
        port = receiver.port
    found = await ask(settings_of(f"http://127.0.0.1:{port}/"))
    assert "no connection to 127.0.0.1" in (found.problem or "")


async def test_one_that_closes_without_an_answer() -> None:
    async def close(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.close()

    async with await asyncio.start_server(close, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        found = await ask(settings_of(f"http://127.0.0.1:{port}/"))
    assert found.status is None
    assert found.problem


async def test_a_name_is_asked_only_at_an_address_of_the_plant() -> None:
    async with Receiver() as receiver:
        url = f"http://localhost:{receiver.port}/"
        found = await ask(settings_of(url, ("localhost",)))
        assert "allowed_networks" in (found.problem or "")
        assert "127.0.0.1" in (found.problem or "")
        assert receiver.n_connections == 0
        found = await ask(settings_of(url, ("localhost",), allowed_networks=LOOPBACK))
        assert (found.problem, receiver.requests[0].headers["Host"]) == (None, f"localhost:{receiver.port}")


def lead_to(monkeypatch: pytest.MonkeyPatch, look_up: Callable[[], list[str]]) -> None:
    """Have all names lead to what `look_up` returns, without a name server."""

    def found(host: str, port: int, family: int, kind: int) -> list[Any]:
        return [(None, kind, 0, "", (address, port)) for address in look_up()]

    monkeypatch.setattr("service.delivery.posting.getaddrinfo", found)


async def test_a_name_without_an_address_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown() -> list[str]:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    lead_to(monkeypatch, unknown)
    found = await ask(settings_of("http://mes.plant.example/", ("mes.plant.example",)))
    assert found.problem == "mes.plant.example has no address: Name or service not known"


@pytest.mark.parametrize("address", ["198.51.100.7", "169.254.169.254", "127.0.0.1", "::1", "2001:db8::1"])
async def test_a_name_server_that_lies_leads_nowhere(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    lead_to(monkeypatch, lambda: [address])
    found = await ask(settings_of("http://mes.plant.example/", ("mes.plant.example",)))
    assert "not in [webhooks] allowed_networks: not asked" in (found.problem or "")


async def test_of_several_addresses_those_of_the_plant_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    lead_to(monkeypatch, lambda: ["198.51.100.7", "127.0.0.2", "127.0.0.1"])
    async with Receiver() as receiver:  # on 127.0.0.1 alone
        url = f"http://mes.plant.example:{receiver.port}/"
        found = await ask(settings_of(url, ("MES.plant.example",), allowed_networks=LOOPBACK))
    assert found.problem is None


async def test_a_name_server_that_does_not_answer_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    answered = threading.Event()

    def wait() -> list[str]:
        answered.wait(PATIENCE_S)
        return []

    lead_to(monkeypatch, wait)
    found = await ask(settings_of("http://mes.plant.example/", ("mes.plant.example",), timeout_s=0.1))
    answered.set()
    assert found.problem == "no answer within 0.1 s"


async def test_tls_is_checked_against_the_configured_certificate() -> None:
    async with Receiver(with_tls=True) as receiver:
        url = f"https://localhost:{receiver.port}/"
        trusting = settings_of(url, ("localhost",), allowed_networks=LOOPBACK, ca_file=CERTIFICATE)
        assert (await ask(trusting)).problem is None
        distrusting = replace(trusting, endpoints=(replace(trusting.endpoints[0], ca_file=None),))
        assert "certificate" in ((await ask(distrusting)).problem or "").lower()
        assert len(receiver.requests) == 1
        by_address = settings_of(f"https://127.0.0.1:{receiver.port}/", ca_file=CERTIFICATE)
        assert (await ask(by_address)).problem is None


async def test_plain_http_spoken_to_a_tls_port_and_the_reverse_are_failures() -> None:
    async with Receiver(with_tls=True) as receiver:
        assert (await ask(settings_of(f"http://127.0.0.1:{receiver.port}/"))).problem
    async with Receiver() as receiver:
        url = f"https://127.0.0.1:{receiver.port}/"
        assert (await ask(settings_of(url, ca_file=CERTIFICATE, timeout_s=1.0))).problem


def test_a_certificate_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.pem", "No such file"), (Path(__file__), "")):
        endpoint = settings_of("https://127.0.0.1/", ca_file=path).endpoints[0]
        with pytest.raises(ValueError, match=f"ca_file: {path}: {reason}"):
            endpoint.tls()
    assert isinstance(settings_of("https://127.0.0.1/").endpoints[0].tls(), ssl.SSLContext)
    assert settings_of("http://127.0.0.1/").endpoints[0].tls() is None
