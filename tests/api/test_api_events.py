"""The feed of events, with the cursor of the feed of results."""

import asyncio
import sqlite3
from collections.abc import Callable

import httpx
import pytest
from support.rest import assert_problem

from service.store import Store
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import transaction


def note(connection: sqlite3.Connection, subject: str) -> None:
    with transaction(connection):
        note_event(
            connection, NewEvent(type=EventType.LOT_OPENED, subject=subject, data={"product": "basalt"})
        )


def forget(connection: sqlite3.Connection, before: int) -> None:
    with transaction(connection):
        connection.execute("DELETE FROM events WHERE seq < ?", (before,))


async def test_events_come_in_order_by_cursor(client: httpx.AsyncClient, store: Store) -> None:
    for lot in ("L1", "L2", "L3"):
        await store.write(note, lot)
    first = (await client.get("/events", params={"limit": 2})).json()
    assert (first["instance_id"], first["first_seq"], first["last_seq"]) == (store.instance_id, 1, 3)
    assert first["next_after"] == 2
    event = first["items"][0]
    assert event.pop("at").endswith("Z")
    assert event == {"seq": 1, "type": "lot.opened", "subject": "L1", "data": {"product": "basalt"}}
    rest = (await client.get("/events", params={"after": 2})).json()
    assert [item["subject"] for item in rest["items"]] == ["L3"]
    assert (await client.get("/events", params={"after": 3})).json()["items"] == []


async def test_a_cursor_that_is_ahead_or_expired_is_told_where_to_go_on(
    client: httpx.AsyncClient, store: Store
) -> None:
    for lot in ("L1", "L2", "L3", "L4"):
        await store.write(note, lot)
    await store.write(forget, 3)
    for path in ("/events", "/events/stream"):
        ahead = await client.get(path, params={"after": 5})
        assert_problem(ahead, 409, "cursor-ahead")
        assert (ahead.json()["first_seq"], ahead.json()["last_seq"]) == (3, 4)
        expired = await client.get(path, params={"after": 1})
        assert_problem(expired, 410, "cursor-expired")
        assert "go on with after=2" in expired.json()["detail"]
    assert len((await client.get("/events", params={"after": 2})).json()["items"]) == 2


async def test_a_long_poll_is_answered_with_the_next_event(
    client: httpx.AsyncClient, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = asyncio.Event()
    wait_while = store.wait_while

    async def observed(is_awaited: Callable[[], bool]) -> None:
        waiting.set()
        await wait_while(is_awaited)

    monkeypatch.setattr(store, "wait_while", observed)
    assert (await client.get("/events", params={"wait_s": 0.01})).json()["items"] == []
    waiting.clear()
    poll = asyncio.create_task(client.get("/events", params={"wait_s": 30}))
    await waiting.wait()
    await store.write(note, "L1")
    assert [item["subject"] for item in (await poll).json()["items"]] == ["L1"]
