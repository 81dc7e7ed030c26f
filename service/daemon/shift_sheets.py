"""The end of each shift is told of once, and its sheet is written to the folder of `[file_drop]` and sent by mail."""

import asyncio
import logging
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import StoreError, WorkerFailure
from service.base.language import Language
from service.daemon.lot_files import FilesFailedError
from service.delivery.file_drop import FileDrop, LotFiles, MakeFiles, Purpose
from service.delivery.mail import Letter, MailSettings, Write
from service.delivery.settings import DropFormat, FileDropSettings
from service.lots.shifts import LotsSettings, Shift, shifts_before
from service.processing.worker_process import worker_boundary
from service.reports.document import NamesAndValues
from service.reports.lot_reports import RigStanding
from service.reports.shift_data import is_complete, shift_document
from service.reports.shift_sheet import SheetRequest, sheet_data, sheet_document, sheet_pdf
from service.store import Store
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import connect_reader
from service.web.control import Control
from service.web.reader_process import Reading

log = logging.getLogger(__name__)

T = TypeVar("T")

LOOK_S = 10.0
"""Time between two looks at the clock."""
PATIENCE = timedelta(minutes=10)
"""Longest wait for the outcomes of the last stones: what is held does not keep a sheet from its readers."""
MOST_MISSED = 100
"""Shifts that ended without a daemon of which is told."""
STEM = "shift-"
"""Beginning of the names of sheets."""


class ShiftWatch:
    """Notes the end of each shift: `run` is its task."""

    def __init__(self, store: Store, control: Control) -> None:
        self._store = store
        self._control = control

    async def run(self) -> None:
        """Look at the clock again and again, until the store is released."""
        while not self._store.is_released:
            try:
                await self.look(datetime.now(UTC).astimezone())
            except StoreError as err:  # health says so, too
                log.warning("the end of a shift is not noted: %s", err)
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await self._store.wait_while(lambda: True)

    async def look(self, now: datetime) -> None:
        """Note the shifts that have ended since the last look; `now` is a local time."""
        starts = self._control.part(LotsSettings).shift_starts
        if (last := await self._store.read(last_end)) is None:
            await self._store.write(note_end, shifts_before(now, starts, 2)[1], is_told=False)
            return
        if now < last.astimezone():  # the clock was set back
            return
        ended = [each for each in shifts_before(now, starts, MOST_MISSED + 1)[1:] if each.until > last]
        for shift in reversed(ended):
            if now < shift.until + PATIENCE and not await self._store.read(is_complete, rfc3339(shift.until)):
                return
            await self._store.write(note_end, shift, is_told=True)
            log.info("shift ended shift=%s", shift.name)


def last_end(connection: sqlite3.Connection) -> datetime | None:
    """Return the end of the newest shift that has ended, None before the first start."""
    (until,) = connection.execute("SELECT max(until) FROM ended_shifts").fetchone()
    return None if until is None else datetime.fromisoformat(until)


def note_end(connection: sqlite3.Connection, shift: Shift, *, is_told: bool) -> None:
    """Note within a transaction that a shift has ended, with its event; nothing happens if it is noted."""
    noted = connection.execute(
        "INSERT OR IGNORE INTO ended_shifts (shift, since, until, dropped_at) VALUES (?, ?, ?, ?)",
        (shift.name, rfc3339(shift.since), rfc3339(shift.until), None if is_told else utc_now()),
    )
    if noted.rowcount and is_told:
        data = asdict(shift_document(shift, shift.until))
        note_event(connection, NewEvent(type=EventType.SHIFT_ENDED, subject=shift.name, data=data))


def ended_shift(connection: sqlite3.Connection, name: str) -> Shift | None:
    """Return a shift that has ended, in local time; None if it is not noted."""
    row = connection.execute("SELECT since, until FROM ended_shifts WHERE shift = ?", (name,)).fetchone()
    if row is None:
        return None
    since, until = (datetime.fromisoformat(each).astimezone() for each in row)
    return Shift(since=since, until=until)


def sheets_drop(store: Store, settings: FileDropSettings | None) -> FileDrop:
    """Return the writer of the sheets of shifts, if the plant wants them in its folder."""
    wanted = settings if settings is not None and settings.shift_sheets else None
    return FileDrop(
        store, wanted, Purpose(check="shift_sheets", due=due_sheets, note=note_sheet, thing="sheet")
    )


def due_sheets(connection: sqlite3.Connection) -> dict[str, bool]:
    """Return the names of the sheets that are not written, oldest first."""
    rows = connection.execute("SELECT shift FROM ended_shifts WHERE dropped_at IS NULL ORDER BY since")
    return {STEM + shift: True for (shift,) in rows}


def note_sheet(connection: sqlite3.Connection, sheet: str, files: LotFiles) -> None:
    """Note that a sheet is written."""
    connection.execute(
        "UPDATE ended_shifts SET dropped_at = ? WHERE shift = ?", (utc_now(), sheet.removeprefix(STEM))
    )


def sheets_maker(store: Store, control: Control, reading: Reading) -> MakeFiles:
    """Return the function that makes the sheet of a shift in the reading process."""

    async def make_sheet(sheet: str, settings: FileDropSettings) -> LotFiles | None:
        wanted = _request(control, settings.language)
        pdf = await reading.run(_made, store.path, sheet.removeprefix(STEM), wanted, sheet_pdf_of)
        return None if pdf is None else LotFiles(revision=None, content={DropFormat.PDF: pdf})

    return make_sheet


def letter_writer(store: Store, control: Control, reading: Reading) -> Write:
    """Return the function that makes the mail of a shift's end in the reading process."""

    async def write(event: Mapping[str, Any], settings: MailSettings) -> Letter | None:
        wanted = _request(control, settings.language)
        return await reading.run(_made, store.path, str(event["subject"]), wanted, letter_of)

    return write


def sheet_pdf_of(connection: sqlite3.Connection, wanted: SheetRequest) -> bytes:
    """Return the PDF of a sheet."""
    return sheet_pdf(sheet_data(connection, wanted))


def letter_of(connection: sqlite3.Connection, wanted: SheetRequest) -> Letter:
    """Return the mail with a sheet: what its first lines say, and the sheet as a file."""
    data = sheet_data(connection, wanted)
    document = sheet_document(data)
    facts = (
        f"{name}: {value}"
        for block in document.sections[0].blocks
        if isinstance(block, NamesAndValues)
        for name, value in block.pairs
    )
    lines = (*document.banners, document.verdict_title, "", *facts, "", document.letterhead.address or "")
    return Letter(
        subject=", ".join(filter(None, (document.title, data.plant.rig, *document.banners))),
        text="\n".join(lines).rstrip() + "\n",
        file_name=f"{STEM}{data.sheet.shift}.pdf",
        pdf=sheet_pdf(data),
    )


def _request(control: Control, language: Language | None) -> Callable[..., SheetRequest]:
    """Return the function that makes the request for the sheet of a `shift`."""
    lots, rig = control.part(LotsSettings), control.part(RigStanding)
    return partial(
        SheetRequest, now=datetime.now(UTC), lots=lots, rig=rig, language=language or lots.report_language
    )


def _made(
    path: Path,
    name: str,
    wanted: Callable[..., SheetRequest],
    make: Callable[[sqlite3.Connection, SheetRequest], T],
) -> T | None:
    """Return `make(connection, request)` for a shift that has ended, None if it is not noted.

    Raises `FilesFailedError` when it cannot be made, for whatever reason.
    """
    try:
        with worker_boundary(), connect_reader(path) as connection:
            shift = ended_shift(connection, name)
            return None if shift is None else make(connection, wanted(shift=shift))
    except WorkerFailure as failure:
        raise FilesFailedError(str(failure).strip().rpartition("\n")[2]) from None
