"""Server-sent events of a real server: resumed, ended, refused, and read by nobody."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from support.outcomes import add, measured
from support.rest import FakeControl, app_of
from support.sent_events import opened
from support.served import Served, served_by

from service.results.fields import ALWAYS
from service.store import Store, open_store
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent
from service.store.keys import create_key, revoke_key
from service.web import connections, streams
from service.web.connections import READING_S, REQUEST_S
from service.web.settings import ApiSettings, Scope


@pytest.fixture
def app(store: Store, control: FakeControl) -> FastAPI:
    return app_of(store, control, ApiSettings())


@pytest.fixture
async def served(app: FastAPI, store: Store) -> AsyncIterator[Served]:
    async with served_by(app) as served:
        yield served
        store.release_waiters()


async def test_results_come_as_they_are_made_and_idle_streams_live(
    served: Served, store: Store, session: int
) -> None:
    await add(store, session, 1, measured())
    stream = await opened(served)
    head = await stream.head()
    assert head.startswith("HTTP/1.1 200")
    assert "content-type: text/event-stream" in head.lower()
    assert "cache-control: no-cache" in head.lower()
    history = await stream.next()
    assert history is not None
    assert (history.event, history.id) == ("history", None)
    assert history.data == {"instance_id": store.instance_id, "first_seq": 1, "last_seq": 1}
    for number in range(1, 4):
        result = await stream.next()
        assert result is not None
        assert (result.event, result.id, result.data["seq"]) == ("result", number, number)
        served.pass_time(1000 * (REQUEST_S + READING_S))
        await add(store, session, number + 1, measured())


async def test_events_come_by_their_type(served: Served, store: Store) -> None:
    stream = await opened(served, "/events/stream?after=0")
    await stream.head()
    await stream.next()
    log = EventLog(store)
    log.note(NewEvent(type=EventType.LOT_OPENED, subject="L1", data={"product": "Kö 8/16\n"}))
    event = await stream.next()
    assert event is not None
    assert (event.event, event.id, event.data["subject"]) == ("lot.opened", 1, "L1")
    assert event.data["data"] == {"product": "Kö 8/16\n"}


async def test_a_client_goes_on_where_it_was_after_a_restart_of_the_server(
    state_dir: Path, control: FakeControl
) -> None:
    got: list[int | None] = []
    more = ""
    for run in range(3):
        with await asyncio.to_thread(open_store, state_dir) as store:
            session = await store.begin_session({})
            app = app_of(store, control, ApiSettings())
            async with served_by(app) as served:
                stream = await opened(served, "/results/stream?after=0", more)
                await stream.head()
                assert (await stream.next()).event == "history"  # type: ignore[union-attr]
                for number in range(30):
                    await add(store, session, 30 * run + number, measured())
                got += await stream.numbers(20)  # the last ten are not read
                store.release_waiters()
        more = f"Last-Event-ID: {got[-1]}\r\n"
    assert got == list(range(1, 61))


async def test_a_stop_sends_what_is_there_and_ends_the_stream(
    served: Served, store: Store, session: int
) -> None:
    stream = await opened(served)
    await stream.head()
    await stream.next()
    await add(store, session, 1, measured())
    store.release_waiters()
    served.server.should_exit = True
    assert await stream.numbers(1) == [1]
    assert await stream.next() is None


async def test_silence_is_broken_by_a_comment(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "HEARTBEAT_S", 0.01)
    stream = await opened(served)
    await stream.head()
    await stream.next()
    for _ in range(3):
        assert await stream.comment_or_event() == ": nothing new"


@pytest.mark.parametrize(
    ("path", "more", "status"),
    [
        ("/results/stream?after=9", "", b"409"),
        ("/results/stream", "Last-Event-ID: 9\r\n", b"409"),
        ("/results/stream?after=1", "Last-Event-ID: 9\r\n", b"409"),
        ("/results/stream", "Last-Event-ID: x\r\n", b"422"),
        ("/events/stream?after=-1", "", b"422"),
        ("/events/stream", "Last-Event-ID: 1\r\n", b"409"),
    ],
)
@pytest.mark.usefixtures("session")
async def test_a_cursor_that_does_not_fit_is_a_problem_before_the_stream(
    served: Served, path: str, more: str, status: bytes
) -> None:
    stream = await opened(served, path, more)
    head = await stream.head()
    assert head.split()[1].encode() == status
    assert "content-type: application/problem+json" in head.lower()


async def test_a_cursor_that_expires_later_ends_the_stream_with_the_problem(
    served: Served, store: Store, session: int
) -> None:
    stream = await opened(served)
    await stream.head()
    await stream.next()
    await store.write(lambda connection: connection.execute("UPDATE store SET first_seq = 3, last_seq = 3"))
    problem = await stream.next()
    assert problem is not None
    assert (problem.event, problem.id) == ("problem", None)
    assert problem.data["type"] == "urn:stonefall:problem:cursor-expired"
    assert "results 1 to 3 were removed: go on with after=3" in problem.data["detail"]
    assert await stream.next() is None


async def test_fields_are_chosen_and_a_stream_is_never_compressed(
    served: Served, store: Store, session: int
) -> None:
    await add(store, session, 1, measured(mass_g=2.5))
    stream = await opened(served, "/results/stream?fields=mass_g", "Accept-Encoding: gzip\r\n")
    assert "content-encoding" not in (await stream.head()).lower()
    await stream.next()
    result = await stream.next()
    assert result is not None
    assert set(result.data) == {*ALWAYS, "mass_g"}
    refused = await opened(served, "/results/stream?fields=weight")
    assert (await refused.head()).startswith("HTTP/1.1 422")


async def test_a_key_that_is_revoked_ends_the_stream(
    store: Store, control: FakeControl, session: int
) -> None:
    _, token = create_key(store.dir, "mes", (Scope.READ,), None, "root")
    async with served_by(app_of(store, control)) as served:
        stream = await opened(served, more=f"Authorization: Bearer {token}\r\nX-Request-Id: one\r\n")
        await stream.head()
        await stream.next()
        revoke_key(store.dir, "mes", "root")
        await add(store, session, 1, measured())
        problem = await stream.next()
        assert problem is not None
        assert (problem.event, problem.data["status"], problem.data["request_id"]) == ("problem", 401, "one")
        assert "key 'mes' was revoked at 2" in problem.data["detail"]
        assert await stream.next() is None
        store.release_waiters()


async def test_streams_leave_connections_to_everything_else(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 12)
    held = [await opened(served) for _ in range(3)]
    for stream in held:
        assert (await stream.head()).startswith("HTTP/1.1 200")
    refused = await opened(served)
    head = await refused.head()
    assert head.startswith("HTTP/1.1 503")
    assert "retry-after: 5" in head.lower()
    held[0].client.writer.close()
    while not (await (again := await opened(served)).head()).startswith("HTTP/1.1 200"):
        again.client.writer.close()


async def test_one_address_leaves_streams_to_the_others(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 32)
    heads = [await (await opened(served)).head() for _ in range(8)]
    assert [head.startswith("HTTP/1.1 200") for head in heads] == 7 * [True] + [False]
    assert (await (await opened(served, address="127.0.0.2")).head()).startswith("HTTP/1.1 200")


async def test_a_stalled_reader_holds_little_and_ends(served: Served, store: Store, session: int) -> None:
    stalled, reading = await opened(served), await opened(served)
    n_results = 0
    # far more than the kernel takes: 300 kB each
    for _ in range(40):
        n_results += 1
        await add(store, session, n_results, measured(detail="x" * 300_000))
    await reading.head()
    await reading.next()
    assert await reading.numbers(n_results) == list(range(1, n_results + 1))
    await served.until(lambda: any(each.n_unread > 0 for each in served.connections))
    (hindering,) = (each for each in served.connections if each.n_unread > 0)
    assert hindering.n_unread < 100 * 310_000
    served.pass_time_since_start(0.9 * READING_S)
    assert len(served.connections) == 2
    served.pass_time(1.1 * READING_S)
    assert len(served.connections) == 1
    await add(store, session, n_results + 1, measured())
    assert await reading.numbers(1) == [n_results + 1]
    stalled.client.writer.close()


async def test_all_streams_share_one_page(
    served: Served, store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = [await opened(served) for _ in range(20)]
    for stream in held:
        await stream.head()
        await stream.next()
    n_reads = 0
    read = store.read

    async def counted(*args: Any) -> Any:
        nonlocal n_reads
        n_reads += 1
        return await read(*args)

    monkeypatch.setattr(store, "read", counted)
    await add(store, session, 1, measured())
    for stream in held:
        assert await stream.numbers(1) == [1]
    assert n_reads < 5
