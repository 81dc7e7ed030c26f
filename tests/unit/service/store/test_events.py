"""Events: numbered without a gap, in their order, whatever the disk does."""

import asyncio
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S
from support.outcomes import add, measured

from service.lots.lots import LotDefinition, assign, close_lot, find_lot, open_lot, void_lot
from service.lots.products import ProductDefinition, save_product
from service.store import Store, event_log, open_store
from service.store.backups import restore
from service.store.event_log import EventLog
from service.store.events import NEW_HISTORY_STEP, EventType, NewEvent, events_after, note_event
from service.store.schema import transaction

CHANGED = EventType.ACQUISITION_CHANGED


def changed(subject: str) -> NewEvent:
    return NewEvent(type=CHANGED, subject=subject, data={"state": "armed"})


def note(connection: sqlite3.Connection, subject: str) -> int:
    with transaction(connection):
        return note_event(connection, changed(subject))


async def subjects(store: Store, after: int = 0) -> list[str]:
    page = await store.read(events_after, after, 1000)
    numbers = [item["seq"] for item in page.items]
    assert numbers == list(range(after + 1, after + 1 + len(numbers)))
    assert (page.last_seq, store.last_event) == (after + len(numbers), after + len(numbers))
    return [item["subject"] for item in page.items]


async def until(is_so: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not is_so():  # noqa: ASYNC110 - another thread makes it so
            await asyncio.sleep(0.005)


async def test_what_is_noted_is_durable_in_its_order_and_wakes_who_waits(store: Store) -> None:
    log = EventLog(store)
    waiting = asyncio.create_task(store.wait_while(lambda: store.last_event <= 4))
    for number in range(5):
        log.note(changed(str(number)))
    await log.written()
    await asyncio.wait_for(waiting, PATIENCE_S)
    assert await subjects(store) == ["0", "1", "2", "3", "4"]
    page = await store.read(events_after, 1, 2)
    assert [item["seq"] for item in page.items] == [2, 3]
    assert page.items[0]["type"] == "acquisition.changed"
    assert page.items[0]["data"] == {"state": "armed"}


async def test_a_number_is_taken_only_if_the_change_is_made(store: Store) -> None:
    def failing(connection: sqlite3.Connection) -> None:
        with transaction(connection):
            note_event(connection, changed("never"))
            raise KeyError

    with pytest.raises(KeyError):
        await store.write(failing)
    await store.write(note, "first")
    assert await subjects(store) == ["first"]


async def test_a_locked_database_loses_no_event_and_no_order(store: Store, state_dir: Path) -> None:
    log = EventLog(store)
    with closing(sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        for number in range(10):
            log.note(changed(str(number)))
            await asyncio.sleep(0)
        await until(lambda: store.trouble is not None)
        await log.written()  # does not wait for what is held
        log.note(changed("10"))
        other.execute("ROLLBACK")
    await until(lambda: store.last_event == 11)
    assert await subjects(store) == [str(number) for number in range(11)]


async def test_what_waits_for_the_disk_is_bounded_and_the_newest_stay(
    store: Store, state_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(event_log, "MAX_WAITING", 3)
    log = EventLog(store)
    with closing(sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        for number in range(10):
            log.note(changed(str(number)))
        await until(lambda: store.trouble is not None)
        other.execute("ROLLBACK")
    await until(lambda: store.last_event == 4)
    assert await subjects(store) == ["0", "7", "8", "9"]
    assert "events are given up, as the store is held: acquisition.changed" in caplog.text


async def test_a_store_that_is_closed_takes_what_it_can(state_dir: Path) -> None:
    store = await asyncio.to_thread(open_store, state_dir)
    log = EventLog(store)
    for number in range(3):
        log.note(changed(str(number)))
    await log.written(10.0)
    await asyncio.to_thread(store.close)
    with await asyncio.to_thread(open_store, state_dir) as again:
        assert again.last_event == 3
        assert await subjects(again) == ["0", "1", "2"]


async def test_the_oldest_events_go(store: Store) -> None:
    def fill(connection: sqlite3.Connection) -> None:
        with transaction(connection):
            connection.execute("UPDATE store SET last_event = 250000")
            connection.executemany(
                "INSERT INTO events VALUES (?, '', 'x', 'y', '{}')", ((n,) for n in range(140_001, 250_001))
            )

    await store.write(fill)
    await store.write(note, "newest")
    page = await store.read(events_after, 0, 1)
    assert (page.first_seq, page.last_seq) == (150_001, 250_001)


async def test_a_history_that_begins_anew_gives_no_number_twice(state_dir: Path) -> None:
    store = await asyncio.to_thread(open_store, state_dir)
    await store.write(note, "kept")
    copy = await store.back_up(4)
    await store.write(note, "lost")
    instance_id = store.instance_id
    await asyncio.to_thread(store.close)
    await asyncio.to_thread(restore, copy, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as again:
        assert again.instance_id != instance_id
        number = await again.write(note, "after")
        assert number == 1 + NEW_HISTORY_STEP + 1


async def test_lots_are_events_in_the_transaction_of_the_change(store: Store) -> None:
    product = ProductDefinition(title="8/16", density_kg_m3=2700)
    await store.write(save_product, "basalt", product, "anna")
    await store.write(open_lot, LotDefinition(lot="L1", tonnage_t=20.0), "basalt", None, "anna")
    await store.write(open_lot, LotDefinition(lot="L1", tonnage_t=20.0), "basalt", None, "anna")
    await store.write(close_lot, "L1", 24.5, "anna")
    await store.write(void_lot, "L1", "wrong", "anna")
    items = (await store.read(events_after, 0, 10)).items
    assert [(item["type"], item["subject"]) for item in items] == [
        ("lot.opened", "L1"),
        ("lot.closed", "L1"),
        ("lot.voided", "L1"),
    ]
    assert (items[1]["data"]["state"], items[1]["data"]["tonnage_t"]) == ("closed", 24.5)
    assert items[2]["data"]["void_reason"] == "wrong"


async def test_each_change_of_a_lot_that_is_not_open_raises_its_revision(store: Store, session: int) -> None:
    product = ProductDefinition(title="8/16", density_kg_m3=2700)
    await store.write(save_product, "basalt", product, "anna")

    async def fall(sequence: int) -> None:
        await add(store, session, sequence, measured())

    async def put_in_lot() -> int:
        done = await store.write(assign, "L1", "2000-01-01T00:00:00.000Z", "2100-01-01T00:00:00.000Z", "anna")
        return 0 if done is None else done[0].revision

    await fall(1)
    await store.write(open_lot, LotDefinition(lot="L1"), "basalt", None, "anna")
    assert await put_in_lot() == 0  # it is open
    await fall(2)
    closed = await store.write(close_lot, "L1", None, "anna")
    assert closed is not None
    assert closed.revision == 1
    await fall(3)
    assert [await put_in_lot(), await put_in_lot()] == [2, 2]  # the second time there is nothing to put
    await store.write(void_lot, "L1", "wrong", "anna")
    voided = await store.read(find_lot, "L1")
    assert voided is not None
    assert voided.revision == 3
    items = (await store.read(events_after, 0, 10)).items
    assert [(item["type"], item["data"]["revision"]) for item in items] == [
        ("lot.opened", 0),
        ("lot.assigned", 0),
        ("lot.closed", 1),
        ("lot.assigned", 2),
        ("lot.voided", 3),
    ]
