"""Endpoints are told of events in order and at least once, over failures, restarts and crashes; simulated time."""

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from support.eventually import PATIENCE_S, soon
from support.webhook_receiver import (
    KEY,
    NEVER,
    OTHER_KEY,
    OTHER_SECRET,
    SECRET,
    TAKEN,
    Receiver,
    answer,
    is_signed,
)

from service.delivery import table
from service.delivery.settings import WebhookEndpoint, WebhooksSettings
from service.delivery.table import deliveries
from service.delivery.webhooks import BeingTestedError, Webhooks, open_webhooks
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import CursorError, EventType, NewEvent

ALL = tuple(EventType)
LOTS = (EventType.LOT_OPENED, EventType.LOT_CLOSED)


class Clock:
    """Time that goes on only while an endpoint waits for its next attempt."""

    def __init__(self) -> None:
        self.time = datetime(2026, 3, 1, tzinfo=UTC)
        self.pauses_s: list[float] = []

    def now(self) -> datetime:
        return self.time

    async def wait(self, event: asyncio.Event, timeout_s: float) -> None:
        self.pauses_s.append(timeout_s)
        self.time += timedelta(seconds=timeout_s)
        await asyncio.sleep(0)


def endpoint(receiver: Receiver, name: str = "mes", **changes: Any) -> WebhookEndpoint:
    url = f"http://127.0.0.1:{receiver.port}/{name}"
    return WebhookEndpoint(name=name, url=url, **({"secrets": (SecretStr(SECRET),)} | changes))


async def webhooks_of(
    store: Store, *endpoints: WebhookEndpoint, clock: Clock | None = None, timeout_s: float = 60.0
) -> Webhooks:
    settings = WebhooksSettings(allowed_hosts=("127.0.0.1",), endpoints=endpoints, timeout_s=timeout_s)
    await open_webhooks(store, settings)
    clock = clock or Clock()
    return Webhooks(store, settings, now=clock.now, chance=lambda: 0.0, wait=clock.wait)


@asynccontextmanager
async def telling(webhooks: Webhooks) -> AsyncIterator[Webhooks]:
    task = asyncio.create_task(webhooks.run())
    try:
        yield webhooks
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def happen(store: Store, *types: EventType) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=each, subject="L1", data={"n": n}) for n, each in enumerate(types)))
    await log.written()


async def until_disabled(webhooks: Webhooks) -> None:
    await soon(lambda: any("disabled" in each for each in webhooks.troubles))


async def until_told(webhooks: Webhooks, after: int, name: str = "mes") -> None:
    async def is_so() -> bool:
        return (await webhooks.status(name)).after >= after

    await soon(is_so)


async def test_an_endpoint_is_told_of_its_events_from_now_on_in_order(store: Store) -> None:
    await happen(store, EventType.LOT_OPENED)  # before it was configured
    async with Receiver() as receiver, telling(await webhooks_of(store, endpoint(receiver, events=LOTS))):
        await happen(store, EventType.HEALTH_CHANGED, EventType.LOT_CLOSED)
        await receiver.received(1)
        await happen(store, *3 * (EventType.LOT_OPENED, EventType.ALARM_RAISED, EventType.LOT_CLOSED))
        requests = await receiver.received(7)
    assert receiver.events == [3, 4, 6, 7, 9, 10, 12]
    assert requests[0].document["type"] == requests[0].document["type"] == "lot.closed"
    assert requests[0].document["data"]["details"] == {"n": 1}
    assert all(is_signed(each.headers, each.body, KEY) for each in requests)
    assert len(set(receiver.ids)) == 7


async def test_what_is_not_taken_is_told_again_under_the_same_id_before_anything_else(store: Store) -> None:
    answers = [answer(500), answer(302, Location="/"), b"?\r\n\r\n", answer(429, Retry_After="77"), TAKEN]
    clock = Clock()
    async with Receiver(answers) as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver), clock=clock)
        async with telling(webhooks):
            await happen(store, EventType.LOT_OPENED, EventType.LOT_CLOSED)
            requests = await receiver.received(6)
            await until_told(webhooks, 2)
    assert receiver.events == [1, 1, 1, 1, 1, 2]
    assert len(set(receiver.ids)) == 2
    assert len({each.body for each in requests}) == 2
    assert clock.pauses_s == [5, 300, 1800, 77]
    stamps = [int(each.headers["webhook-timestamp"]) for each in requests]
    assert [stamp - stamps[0] for stamp in stamps] == [0, 5, 305, 2105, 2182, 2182]
    found = await store.read(deliveries, "mes", 10)
    assert [(each.event, each.attempt, each.status) for each in reversed(found)] == [
        (1, 1, 500),
        (1, 2, 302),
        (1, 3, None),
        (1, 4, 429),
        (1, 5, 204),
        (2, 1, 204),
    ]
    assert "not HTTP" in (found[3].problem or "")
    assert (await webhooks.status("mes")).last_problem is None


async def test_after_a_day_of_failures_it_is_disabled_until_somebody_enables_it(store: Store) -> None:
    clock = Clock()
    async with Receiver([answer(500)] * 8) as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver), clock=clock)
        async with telling(webhooks):
            await happen(store, EventType.LOT_OPENED, EventType.LOT_CLOSED)
            await until_disabled(webhooks)
            assert webhooks.troubles == [
                "mes: disabled since 2026-03-02T00:00:00.000Z: HTTP 500 Internal Server Error"
            ]
            check = webhooks.checks()["webhooks"]
            assert (check.status, check.observed_value, check.observed_unit) == ("warn", 1, "disabled")
            assert check.detail == webhooks.troubles[0]
            assert sum(clock.pauses_s) == 86_400
            await happen(store, EventType.LOT_OPENED)
            status = await webhooks.status("mes")
            assert (status.waiting, status.attempts, len(receiver.requests)) == (3, 8, 8)
        again = await webhooks_of(store, endpoint(receiver), clock=clock)
        async with telling(again):  # after a restart
            await until_disabled(again)
            assert (await again.test("mes", "somebody")).status == 204
            await again.enable("mes", "somebody")
            await until_told(again, 3)
            assert again.troubles == []
            assert again.checks()["webhooks"].status == "pass"
    assert [each.document["data"]["seq"] for each in receiver.requests[8:]] == [None, 1, 2, 3]
    assert receiver.requests[8].document["type"] == "webhook.test"
    assert receiver.ids[9] == receiver.ids[0]


async def test_fifteen_minutes_of_failures_are_told_while_it_is_still_tried(store: Store) -> None:
    clock, pausing = Clock(), asyncio.Event()

    async def wait(event: asyncio.Event, timeout_s: float) -> None:
        if timeout_s < 900:
            await clock.wait(event, timeout_s)
        else:
            pausing.set()
            await event.wait()

    async with Receiver([answer(500)] * 3) as receiver:
        settings = WebhooksSettings(allowed_hosts=("127.0.0.1",), endpoints=(endpoint(receiver),))
        await open_webhooks(store, settings)
        webhooks = Webhooks(store, settings, now=clock.now, chance=lambda: 0.0, wait=wait)
        async with telling(webhooks), asyncio.timeout(PATIENCE_S):
            await happen(store, EventType.LOT_OPENED)
            await pausing.wait()
            assert (sum(clock.pauses_s), webhooks.troubles) == (305, [])
            clock.time += timedelta(seconds=900 - 305)
            assert webhooks.troubles == [
                "mes: takes nothing since 2026-03-01T00:00:00.000Z: HTTP 500 Internal Server Error"
            ]
            await webhooks.enable("mes", "somebody")
            await until_told(webhooks, 1)
            assert webhooks.troubles == []


async def test_one_that_is_gone_is_told_nothing_more(store: Store) -> None:
    async with Receiver([answer(410)]) as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        async with telling(webhooks):
            await happen(store, EventType.LOT_OPENED, EventType.LOT_CLOSED)
            await until_disabled(webhooks)
    assert receiver.events == [1]
    assert "HTTP 410 Gone" in webhooks.troubles[0]


async def test_a_crash_between_sending_and_noting_tells_it_again_under_the_same_id(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    noting = asyncio.Event()

    async def never(*_: object) -> None:
        noting.set()
        await asyncio.Event().wait()

    async with Receiver() as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        await happen(store, EventType.LOT_OPENED, EventType.LOT_CLOSED)
        with monkeypatch.context() as patched:
            patched.setattr(store, "write", never)
            async with telling(webhooks), asyncio.timeout(PATIENCE_S):
                await noting.wait()
        webhooks = await webhooks_of(store, endpoint(receiver))
        async with telling(webhooks):
            await until_told(webhooks, 2)
    assert receiver.events == [1, 1, 2]
    assert receiver.ids[0] == receiver.ids[1]


async def test_a_dead_endpoint_delays_no_other(store: Store) -> None:
    async with Receiver([NEVER] * 3) as dead, Receiver() as live:
        webhooks = await webhooks_of(store, endpoint(dead, "dead"), endpoint(live, "live"), timeout_s=60.0)
        async with telling(webhooks):
            await happen(store, *20 * [EventType.ALARM_RAISED])
            await live.received(20)
            assert [len(each.requests) for each in (dead, live)] == [1, 20]


async def test_secrets_are_rotated_without_a_restart(store: Store, tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text(SECRET + "\n")
    async with Receiver() as receiver:
        files = {"secrets": (), "secret_files": (old, new)}
        webhooks = await webhooks_of(store, endpoint(receiver, **files))
        async with telling(webhooks):
            problem = (await webhooks.test("mes", "somebody")).problem
            assert problem == f"secret_files: {new}: No such file or directory"
            new.write_text(OTHER_SECRET)
            await webhooks.test("mes", "somebody")
            old.write_text(OTHER_SECRET)
            await webhooks.test("mes", "somebody")
    first, second = receiver.requests
    assert [is_signed(first.headers, first.body, key) for key in (KEY, OTHER_KEY)] == [True, True]
    assert [is_signed(second.headers, second.body, key) for key in (KEY, OTHER_KEY)] == [False, True]


async def test_a_replay_tells_again_under_the_same_ids_and_leads_forward_too(store: Store) -> None:
    async with Receiver() as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        async with telling(webhooks):
            await happen(store, *4 * [EventType.ALARM_RAISED])
            await until_told(webhooks, 4)
            await webhooks.replay("mes", 2, "somebody")
            await receiver.received(6)
            await until_told(webhooks, 4)
            for after in (5, 10**9):
                with pytest.raises(CursorError, match="events 1 to 4 are kept"):
                    await webhooks.replay("mes", after, "somebody")
            receiver.answer_next(NEVER)
            await happen(store, *3 * [EventType.ALARM_RAISED])
            await receiver.received(7)
            await webhooks.replay("mes", 7, "somebody")  # while it is being told of 5
            assert (await webhooks.status("mes")).waiting == 0
    assert receiver.events == [1, 2, 3, 4, 3, 4, 5]
    assert receiver.ids[2:4] == receiver.ids[4:6]


async def test_what_somebody_asks_for_while_a_message_is_sent_holds(store: Store) -> None:
    async with Receiver([NEVER]) as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        async with telling(webhooks):
            await happen(store, *3 * [EventType.ALARM_RAISED])
            await receiver.received(1)
            await webhooks.replay("mes", 2, "somebody")
            receiver.release()
            await until_told(webhooks, 3)
    assert receiver.events == [1, 3]


async def test_one_test_at_a_time(store: Store) -> None:
    async with Receiver([NEVER]) as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        testing = asyncio.create_task(webhooks.test("mes", "somebody"))
        await receiver.received(1)
        with pytest.raises(BeingTestedError):
            await webhooks.test("mes", "somebody")
        receiver.release()
        assert (await testing).problem is None
        assert (await webhooks.test("mes", "somebody")).problem is None


async def test_the_history_of_an_endpoint_is_bounded(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "MAX_DELIVERIES", 5)
    async with Receiver() as receiver:
        both = endpoint(receiver), endpoint(receiver, "other")
        webhooks = await webhooks_of(store, *both)
        for name in ("other", *["mes"] * 8):
            await webhooks.test(name, "somebody")
    assert [len(await store.read(deliveries, name, 100)) for name in ("mes", "other")] == [5, 1]


async def test_events_that_are_no_longer_kept_are_told_of_in_the_log(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    async with Receiver() as receiver:
        webhooks = await webhooks_of(store, endpoint(receiver))
        await happen(store, *5 * [EventType.ALARM_RAISED])
        await store.write(lambda connection: connection.execute("DELETE FROM events WHERE seq < 4") and None)
        async with telling(webhooks):
            await receiver.received(2)
    assert receiver.events == [4, 5]
    assert "events before 4 are no longer kept" in caplog.text


@pytest.mark.parametrize("n_endpoints", [0, 3])
async def test_a_stop_ends_all_waiting(store: Store, n_endpoints: int) -> None:
    async with Receiver() as receiver:
        names: Iterable[str] = (f"mes{n}" for n in range(n_endpoints))
        webhooks = await webhooks_of(store, *(endpoint(receiver, name) for name in names))
        running = asyncio.create_task(webhooks.run())
        await happen(store, EventType.LOT_OPENED)
        await receiver.received(n_endpoints)
        store.release_waiters()
        async with asyncio.timeout(PATIENCE_S):
            await running


async def test_other_endpoints_are_taken_while_it_runs(store: Store) -> None:
    async with Receiver() as before, Receiver() as after, telling(await webhooks_of(store)) as webhooks:
        for receiver, name in ((before, "old"), (after, "new")):
            settings = WebhooksSettings(allowed_hosts=("127.0.0.1",), endpoints=(endpoint(receiver, name),))
            await webhooks.use(settings)
            await happen(store, EventType.LOT_OPENED)
            await receiver.received(1)
        assert webhooks.find("old") is None
        assert (before.events, after.events) == ([1], [2])


async def test_endpoints_that_are_taken_away_between_two_attempts_end_nothing(store: Store) -> None:
    async with Receiver([answer(500)]) as before, Receiver() as after:
        old, new = (
            WebhooksSettings(allowed_hosts=("127.0.0.1",), endpoints=(endpoint(receiver, name),))
            for receiver, name in ((before, "old"), (after, "new"))
        )

        async def wait(_: asyncio.Event, __: float) -> None:
            await webhooks.use(new)  # and at once the task of `old` goes on

        await open_webhooks(store, old)
        webhooks = Webhooks(store, old, wait=wait)
        async with telling(webhooks):
            await happen(store, EventType.LOT_OPENED)
            await soon(lambda: webhooks.find("new") is not None)
            await happen(store, EventType.LOT_CLOSED)
            await after.received(1)
    assert after.events == [2]
