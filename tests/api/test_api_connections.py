"""A real server on loopback: clients that do not get on are dropped, none takes the others' place, long polls live."""

import asyncio
import json
import logging
import resource
from collections.abc import AsyncIterator

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import Response
from starlette.middleware import Middleware
from starlette.types import ASGIApp, Receive, Scope, Send
from support.outcomes import add, measured
from support.rest import FakeControl, app_of
from support.served import PATIENCE_S, Served, served_by

from service.store import Store
from service.web import connections
from service.web.connections import READING_S, REQUEST_S, max_connections
from service.web.pieces import PIECE_BYTES
from service.web.settings import ApiSettings

HALF = b"GET /api/v1/res"
LIVE = b"GET /api/v1/health/live HTTP/1.1\r\nHost: localhost\r\n\r\n"
POLL = b"GET /api/v1/results?wait_s=30 HTTP/1.1\r\nHost: localhost\r\n\r\n"
PUT = b"PUT /api/v1/acquisition HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
LARGE = b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n"
N_LARGE = 20_000_000
"""Far more than the kernel takes for a client that does not read."""


class Large:
    """Answers `LARGE`, within all that the application does with answers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer = Response(bytes(N_LARGE)) if scope.get("path") == "/large" else self._app
        await answer(scope, receive, send)


@pytest.fixture
def app(store: Store, control: FakeControl) -> FastAPI:
    app = app_of(store, control, ApiSettings())
    app.user_middleware.append(Middleware(Large))  # the innermost; routes are shared with other tests
    return app


@pytest.fixture
async def served(app: FastAPI) -> AsyncIterator[Served]:
    async with served_by(app) as served:
        yield served


@pytest.mark.parametrize(
    "data",
    [
        b"",
        HALF,
        LIVE[:-2] + b"X-More: ",
        PUT + b'Content-Length: 20\r\n\r\n{"state"',
        PUT + b'Transfer-Encoding: chunked\r\n\r\n8\r\n{"state"\r\n',
        LIVE + HALF,  # its first request is answered
        PUT + b"Content-Length: 2000000\r\n\r\n{",  # refused, and goes on sending
    ],
)
async def test_a_request_that_does_not_come_ends_the_connection(
    served: Served, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    client = await served.connect(data)
    await served.until(lambda: len(served.connections) == 1)
    if data.startswith(LIVE) or b"2000000" in data:
        await client.reader.readuntil(b"}")
        client.send(b"x")  # an idle connection has time, one with a begun request has not
        (connection,) = served.connections
        await served.until(lambda: connection.timeout_keep_alive_task is None)
    served.pass_time_since_start(0.9 * REQUEST_S)
    assert len(served.connections) == 1
    served.pass_time(1.1 * REQUEST_S)
    assert not served.connections
    assert b'"state"' not in await client.rest()
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("http://127.0.0.1:8080/api/v1/health/live", 200),
        ("HTTP://localhost/api/v1/%68ealth/live", 200),
        ("https://localhost/api/v1/results?after=0", 200),
        ("http://localhost", 200),
        ("http://localhost/api/v1/nothing", 404),
        ("http://rebound.example/api/v1/results", 421),
        ("http://localhost@rebound.example/api/v1/results", 404),
        ("ftp://localhost/api/v1/results", 404),
    ],
)
async def test_a_target_that_is_a_whole_address_is_answered_as_its_path(
    served: Served, target: str, status: int
) -> None:
    """RFC 9112, 3.2.2: proxies and some PLCs send it; its host counts, not the header `Host`."""
    client = await served.connect(f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert (await client.reader.readline()).startswith(f"HTTP/1.1 {status} ".encode())


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("/api/v1//results", 200),
        ("//api/v1/results", 200),
        ("//api/v1///results?limit=1", 200),
        ("http://localhost//api/v1//results", 200),
        ("/api/v1//lots/x//close", 404),
        ("/api/v1/particles//mesh.ply", 404),
        ("/api/v1/", 404),
        ("//results", 404),
    ],
)
async def test_a_base_that_ends_with_a_slash_is_joined_to_paths_that_begin_with_one(
    served: Served, target: str, status: int
) -> None:
    client = await served.connect(f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert (await client.reader.readline()).startswith(f"HTTP/1.1 {status} ".encode())


async def test_the_host_of_a_whole_address_counts_in_place_of_a_foreign_header(served: Served) -> None:
    client = await served.connect(
        LIVE.replace(b"GET ", b"GET http://127.0.0.1").replace(b"localhost", b"a.b")
    )
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 200")


async def test_no_consumer_has_a_name_that_clients_take_out_of_an_address(served: Served) -> None:
    head = PUT.replace(b"acquisition", b"consumers/../cursor") + b"Content-Length: 12\r\n\r\n"
    client = await served.connect(head + b'{"after": 0}')
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 422")


async def test_an_offer_of_http_2_is_not_taken_and_fills_no_log(
    served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    offer = b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAEAAEAAAAIAAAAA\r\n\r\n"
    client = await served.connect(LIVE[:-2] + offer)
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 200")
    assert [record for record in caplog.records if record.name.startswith("uvicorn")] == []


async def test_the_server_looks_after_them_itself(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_S", 0.0)
    client = await served.connect(HALF)
    assert await client.rest() == b""


async def test_a_reader_that_does_not_read_ends_its_connection(served: Served) -> None:
    slow, reading = await served.connect(LARGE), await served.connect(LARGE)
    assert (await reading.reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 200")
    assert len(await reading.reader.readexactly(N_LARGE)) == N_LARGE
    await served.until(lambda: sum(each.n_unread > 0 for each in served.connections) == 1)
    served.pass_time_since_start(0.9 * READING_S)
    assert len(served.connections) == 2
    served.pass_time(1.1 * READING_S)
    assert len(served.connections) == 1
    assert 0 < len(await slow.rest()) < N_LARGE


async def test_what_a_reader_does_not_read_is_not_copied_for_it(served: Served) -> None:
    await served.connect(LARGE)
    await served.until(lambda: any(each.n_unread > 0 for each in served.connections))
    (connection,) = served.connections
    assert connection.n_unread > N_LARGE / 2
    assert connection.transport.get_write_buffer_size() <= PIECE_BYTES


async def test_the_rest_of_a_refused_body_is_read_slowly_and_its_client_gets_the_answer(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "IN_VAIN_BYTES_S", 1)
    client = await served.connect(PUT + b"Content-Length: 100000000\r\n\r\n" + bytes(1_000_000))
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 413")
    await served.until(lambda: any(each.flow.read_paused for each in served.connections))
    served.pass_time(1.1 * REQUEST_S)
    assert not served.connections


async def test_a_connection_serves_the_next_request_after_a_refused_body(served: Served) -> None:
    client = await served.connect(PUT + b"Content-Length: 2000000\r\n\r\n" + bytes(2_000_000))
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 413")
    await client.reader.readuntil(b"}")
    client.send(LIVE)
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 200")


async def test_what_is_unread_is_bounded_and_the_slowest_goes_first(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MAX_UNREAD_BYTES", 1.5 * N_LARGE)
    clients = []
    for n in (1, 2):
        clients.append(await served.connect(LARGE))
        await served.until(lambda n=n: sum(each.n_unread > 0 for each in served.connections) >= n)
    served.pass_time(0)
    assert len(served.connections) == 1
    assert len(await clients[0].rest()) < N_LARGE
    await clients[1].reader.readuntil(b"\r\n\r\n")
    assert len(await clients[1].reader.readexactly(N_LARGE)) == N_LARGE


async def test_a_long_poll_lives_as_long_as_it_asks_for(
    served: Served, store: Store, session: int, waiting: asyncio.Event
) -> None:
    poll = await served.connect(POLL)
    await waiting.wait()
    for _ in range(3):
        served.pass_time(1000 * REQUEST_S)
    await add(store, session, 1, measured())
    async with asyncio.timeout(PATIENCE_S):
        assert (await poll.reader.readline()).startswith(b"HTTP/1.1 200")
        await poll.reader.readuntil(b'"pin_reason":null}]}')
    poll.send(LIVE)  # the same connection serves the next request
    assert (await poll.reader.readline()).startswith(b"HTTP/1.1 200")


async def test_the_oldest_without_a_request_makes_room(
    served: Served, monkeypatch: pytest.MonkeyPatch, waiting: asyncio.Event, store: Store
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 4)
    poll = await served.connect(POLL)
    await waiting.wait()
    halves = [await served.connect(HALF) for _ in range(20)]
    client = await served.connect(LIVE)
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 200")
    assert len(served.connections) <= 4
    for half in halves[:10]:
        assert await half.rest() == b""
    store.release_waiters()
    assert (await poll.reader.readline()).startswith(b"HTTP/1.1 200")


async def test_when_all_are_being_answered_the_newest_is_refused(
    served: Served, monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 4)
    polls = [await served.connect(POLL) for _ in range(4)]
    await served.until(lambda: sum(each.is_being_answered for each in served.connections) == 4)
    for _ in range(2 * connections.MAX_REFUSED):
        refused = await served.connect(LIVE)
        head, _, body = (await refused.rest()).partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 503 Service Unavailable\r\n")
        assert b"\r\nRetry-After: 5" in head
        assert json.loads(body)["type"] == "urn:stonefall:problem:too-many-connections"
        assert len(served.connections) <= 4 + connections.MAX_REFUSED
    store.release_waiters()
    for poll in polls:
        assert (await poll.reader.readline()).startswith(b"HTTP/1.1 200")
        poll.writer.close()
    await served.until(lambda: len(served.connections) < 4)
    client = await served.connect(LIVE)
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 200")


@pytest.mark.full
async def test_one_address_does_not_keep_the_others_out(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 16)
    for _ in range(14):
        await served.connect(POLL)
    await served.until(lambda: sum(each.is_being_answered for each in served.connections) == 14)
    refused = await (await served.connect(POLL)).rest()
    assert b"503" in refused.splitlines()[0]
    assert b"14 requests are being answered already" in refused
    for _ in range(3):  # the second and third, as the first one is without a request then
        other = await served.connect(LIVE, "127.0.0.2")
        assert b"200 OK" in await other.reader.readline()
    assert sum(each.is_being_answered for each in served.connections) == 14


@pytest.mark.parametrize(("n_descriptors", "n"), [(1024, 256), (4096, 256), (400, 100), (2, 1)])
def test_connections_leave_descriptors_for_everything_else(
    monkeypatch: pytest.MonkeyPatch, n_descriptors: int, n: int
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (n_descriptors, n_descriptors))
    assert max_connections.__wrapped__() == n


async def test_a_real_server_stops_at_once_under_a_long_poll(
    served: Served, store: Store, waiting: asyncio.Event
) -> None:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{served.port}/api/v1") as client:
        live = await client.get("/health/live")
        assert "server" not in live.headers
        poll = asyncio.create_task(client.get("/results", params={"wait_s": 30}))
        await waiting.wait()
        store.release_waiters()
        served.server.should_exit = True
        assert (await asyncio.wait_for(poll, 5)).status_code == 200


@pytest.mark.parametrize(
    "head",
    [
        b"GET /api/v1/live HTTP/1.1\nHost: x\n\n",
        b"GET /api/v1/live HTTP/1.1\r\nHost: x\nX-A: 1\r\n\r\n",
        b"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nX-A: 1\r\n 2\r\n\r\n",
        b"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nX-A:\r\n\t2\r\n\r\n",
    ],
)
async def test_a_head_that_a_proxy_may_read_otherwise_is_refused(served: Served, head: bytes) -> None:
    client = await served.connect(head)
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 400")


async def test_a_request_with_a_body_that_cannot_be_read_is_answered_once(
    served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    client = await served.connect(LIVE[:-2] + b"Transfer-Encoding: chunked\r\n\r\n-1\r\n\r\n")
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 400")
    assert b"HTTP/1.1" not in await client.rest()
    await served.until(lambda: not served.connections)
    assert "Traceback" not in caplog.text


async def test_a_head_without_an_end_is_refused(served: Served) -> None:
    client = await served.connect(LIVE[:-2] + b"X-More: " + 100_000 * b"a")
    assert (await client.reader.readline()).startswith(b"HTTP/1.1 400")
    client.writer.close()
    await served.until(lambda: not served.connections)
