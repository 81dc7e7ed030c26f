"""The end of each shift is noted once, its sheet is written and mailed once, whatever happens in between."""

import asyncio
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from io import BytesIO
from pathlib import Path

import pytest
from pypdf import PdfReader
from support.calibration_desk import open_desk
from support.eventually import soon
from support.outcomes import measured, trigger
from support.rest import FakeControl, ReadingThread
from support.smtp_server import SmtpServer

from pipeline.frames import rfc3339
from service.daemon.shift_sheets import ShiftWatch, letter_writer, sheets_drop, sheets_maker
from service.delivery.file_drop import FileDrop
from service.delivery.mail import Mail, MailSettings, MailTls
from service.delivery.settings import FileDropSettings
from service.lots.plant import PlantSettings
from service.store import Store
from service.store.events import events_after

SIX = datetime(2026, 3, 2, 6).astimezone()
HOUR = timedelta(hours=1)


@pytest.fixture
def control(tmp_path: Path) -> FakeControl:
    return FakeControl(calibrations=open_desk(tmp_path / "desk"), plant=PlantSettings(plant="Quarry North"))


async def until_rows(store: Store, table: str, n_rows: int) -> None:
    """Wait until a table has so many rows: what is sent and not noted is sent again."""

    async def is_so() -> bool:
        query = f"SELECT count(*) FROM {table}"  # noqa: S608 - of this module
        (found,) = await store.read(lambda connection: connection.execute(query).fetchone())
        return int(found) >= n_rows

    await soon(is_so)


async def told(store: Store) -> list[str]:
    return [each["subject"] for each in (await store.read(events_after, 0, 100)).items]


async def test_a_shift_is_told_of_once_across_restarts_and_clocks_that_are_set(
    store: Store, control: FakeControl
) -> None:
    await ShiftWatch(store, control).look(SIX + HOUR)
    assert await told(store) == []  # what was before the first start
    for hours in (7.9, 8.1, 8.2):
        await ShiftWatch(store, control).look(SIX + hours * HOUR)
    assert await told(store) == ["2026-03-02-0600"]
    await ShiftWatch(store, control).look(SIX + 1 * HOUR)  # an hour before
    await ShiftWatch(store, control).look(SIX + 33 * HOUR)  # no daemon for a day
    names = ["0302-0600", "0302-1400", "0302-2200", "0303-0600"]
    assert await told(store) == [f"2026-{each[:2]}-{each[2:]}" for each in names]
    (event,) = (await store.read(events_after, 1, 1)).items
    assert event["data"] == {
        "shift": "2026-03-02-1400",
        "since": rfc3339(SIX + 8 * HOUR),
        "until": rfc3339(SIX + 16 * HOUR),
        "is_over": True,
    }


async def test_the_last_stones_are_waited_for_but_not_for_ever(store: Store, control: FakeControl) -> None:
    session = await store.begin_session({"is_replay": False})
    watch = ShiftWatch(store, control)
    await watch.look(SIX + HOUR)
    late = replace(trigger(1), utc=rfc3339(SIX + 7.99 * HOUR))
    await store.record_triggers(session, {"00000001": late})
    await watch.look(SIX + 8.01 * HOUR)
    assert await told(store) == []
    await store.finish(session, "00000001", measured())
    await watch.look(SIX + 8.02 * HOUR)
    assert await told(store) == ["2026-03-02-0600"]
    await store.record_triggers(session, {"00000002": replace(late, utc=rfc3339(SIX + 15 * HOUR))})
    await watch.look(SIX + 16.1 * HOUR)
    assert len(await told(store)) == 1
    await watch.look(SIX + 16.2 * HOUR)
    assert len(await told(store)) == 2


async def test_a_sheet_is_written_and_mailed_once(store: Store, control: FakeControl, tmp_path: Path) -> None:
    folder, reading, watch = tmp_path / "drop", ReadingThread(), ShiftWatch(store, control)
    folder.mkdir()
    async with SmtpServer() as server:
        settings = MailSettings(
            host="127.0.0.1",
            port=server.port,
            tls=MailTls.NONE,
            sender="rig@plant.example",
            recipients=("a@plant.example",),
        )

        def started() -> list[asyncio.Task[None]]:
            drop: FileDrop = sheets_drop(store, FileDropSettings(dir=folder, shift_sheets=True))
            return [
                asyncio.create_task(drop.run(sheets_maker(store, control, reading))),
                asyncio.create_task(Mail(store, settings).run(letter_writer(store, control, reading))),
            ]

        async def stopped(tasks: list[asyncio.Task[None]]) -> None:
            for task in tasks:
                task.cancel()
                with suppress(asyncio.CancelledError):
                    await task

        await watch.look(SIX + HOUR)
        tasks = started()
        await until_rows(store, "webhooks", 1)  # the outbox begins with the events from now on
        await watch.look(SIX + 9 * HOUR)
        first = folder / "shift-2026-03-02-0600.pdf"
        await soon(first.exists)
        await until_rows(store, "ended_shifts WHERE dropped_at IS NOT NULL", 2)
        await until_rows(store, "webhook_deliveries", 1)
        await stopped(tasks)
        first.unlink()
        tasks = started()
        await watch.look(SIX + 17 * HOUR)
        await soon((folder / "shift-2026-03-02-1400.pdf").exists)
        await until_rows(store, "webhook_deliveries", 2)
        await stopped(tasks)
        assert not first.exists()
        message = server.taken[0]
        assert message["Subject"] == "Shift of 2026-03-02, 06:00 – 14:00, Quarry North"
        assert "0 stones" in message.get_body().get_content()
        (file,) = message.iter_attachments()
        assert file.get_filename() == first.name
        assert len(PdfReader(BytesIO(file.get_content())).pages) == 1


async def test_without_being_asked_for_nothing_is_written(store: Store, tmp_path: Path) -> None:
    for settings in (None, FileDropSettings(dir=tmp_path)):
        await asyncio.wait_for(
            sheets_drop(store, settings).run(sheets_maker(store, FakeControl(), ReadingThread())), 5
        )
