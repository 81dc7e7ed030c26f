"""Write files into a folder, of each revision of a closed lot once; what could not be written is made up for.

Which revision of a lot is written is noted in the store after its files are durable: after a crash in between they are
written again, under the same names. Files of `[file_drop]`, issued reports, which complete a lot, and
sheets of shifts come about so.
"""

import asyncio
import logging
import sqlite3
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from drivers.files.durable import remove_unfinished, write_file
from drivers.files.times import utc_now
from service.base.abandonable import start_abandonable
from service.base.errors import ServiceError, StoreError
from service.base.messages import Code, message
from service.base.status import Checks, trouble_check
from service.delivery.settings import DropFormat, FileDropSettings
from service.store import Store

log = logging.getLogger(__name__)

RETRY_S = 30.0
"""Pause before a folder that took no file is tried again."""
LOOK_S = 0.2
"""Time between two looks at a lot whose last stones are still being measured."""
ANSWER_S = 30.0
"""A folder that has not taken a file for so long does not answer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LotFiles:
    """The files of a lot, or of a shift, made at one moment."""

    revision: int | None
    """Revision of the lot, which their names end with; None: there is but one."""
    content: Mapping[DropFormat, bytes]
    outcome: Mapping[str, Any] = field(default_factory=dict)
    """Verdict and counts of the lot, for what is noted of them."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Figures that control charts follow, as JSON has them."""


MakeFiles = Callable[[str, FileDropSettings], Awaitable[LotFiles | None]]
"""Returns the files of a lot, in all formats; None if there is no such lot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Purpose:
    """What files of lots are written for."""

    check: str
    """Check of health that tells of trouble."""
    due: Callable[[sqlite3.Connection], dict[str, bool]]
    """Reads the lots whose revision is not written, oldest first; True: all stones have outcomes, so it may be."""
    note: Callable[[sqlite3.Connection, str, LotFiles], None]
    """Notes within a transaction that files of a lot are durable."""
    thing: str = "lot"
    """What the names are of."""


async def open_file_drop(store: Store, settings: FileDropSettings | None) -> "FileDrop":
    """Return the file drop of the plant's folder, as an earlier run of the daemon has left it."""
    if settings is not None:
        await store.write(begin_file_drop)
    return FileDrop(store, settings)


class FileDrop:
    """Writes the files of closed lots: `run` is its task, `trouble` says why it cannot."""

    def __init__(
        self,
        store: Store,
        settings: FileDropSettings | None,
        purpose: Purpose | None = None,
        *,
        retry_s: float = RETRY_S,
        answer_s: float = ANSWER_S,
    ) -> None:
        self._store = store
        self._settings = settings
        self._purpose = purpose or FOR_THE_PLANT
        self._retry_s = retry_s
        self._answer_s = answer_s
        self._is_first = True
        self.trouble: str | None = None

    def checks(self) -> Checks:
        return {self._purpose.check: trouble_check(self.trouble)}

    async def run(self, make_files: MakeFiles) -> None:
        """Write what is due whenever something is, until waiting in the store is ended."""
        if self._settings is None:
            return
        while not self._store.is_released:
            last_event = self._store.last_event
            pause_s = await self._look(self._settings, make_files)
            with suppress(TimeoutError):
                async with asyncio.timeout(pause_s):
                    await self._store.wait_for_event(last_event)

    async def _look(self, settings: FileDropSettings, make_files: MakeFiles) -> float | None:
        """Write what is due; return how long to wait for the next look, None: until something happens."""
        troubles = []
        due: dict[str, bool] = {}
        try:
            due = await self._store.read(self._purpose.due)
            for lot in (lot for lot, is_complete in due.items() if is_complete):
                try:
                    await self._drop(settings, lot, make_files)
                except ServiceError as err:  # of this lot; the others are written
                    troubles.append(f"{self._purpose.thing} {lot}: {err}")
        except StoreError as err:
            troubles.append(str(err))
        except OSError as err:
            troubles.append(f"{settings.dir}: {err.strerror or err}")
        said = "; ".join(troubles)
        trouble = message(Code.FILES_NOT_WRITTEN, reported=said) if said else None
        if trouble is not None and trouble != self.trouble:
            log.error("%s: %s", self._purpose.check, trouble)
        self.trouble = trouble
        if trouble is not None:
            return self._retry_s
        return None if all(due.values()) else LOOK_S

    async def _drop(self, settings: FileDropSettings, lot: str, make_files: MakeFiles) -> None:
        files = await make_files(lot, settings)
        if files is None:
            return
        stem = lot if files.revision is None else f"{lot}-{files.revision}"
        by_path = {settings.dir / f"{stem}.{each}": content for each, content in files.content.items()}
        writing = start_abandonable(
            "file drop", partial(write_files, is_first=self._is_first), settings, by_path
        )
        while not (await asyncio.wait([writing], timeout=self._answer_s))[0]:
            self.trouble = message(Code.FOLDER_SILENT, folder=str(settings.dir), waited_s=self._answer_s)
            log.error("%s: %s", self._purpose.check, self.trouble)
        writing.result()
        self._is_first = False
        await self._store.write(self._purpose.note, lot, files)
        log.info("files written name=%s dir=%s", stem, settings.dir)


def write_files(settings: FileDropSettings, files: Mapping[Path, bytes], *, is_first: bool) -> None:
    """Write files, each whole or not at all; raise `OSError` if the folder is not there or takes none.

    Before the first ones, what a killed daemon left goes.
    """
    settings.require_present()
    if is_first:
        remove_unfinished(settings.dir)
    for path, content in files.items():
        write_file(path, content)


def begin_file_drop(connection: sqlite3.Connection) -> None:
    """Note at the first start with a folder that lots closed until now are not due."""
    is_first = connection.execute(
        "INSERT OR IGNORE INTO file_drop (one, began_at) VALUES (1, ?)", (utc_now(),)
    ).rowcount
    if is_first:
        connection.execute(
            "INSERT INTO dropped_lots (lot, revision, at) SELECT lot, revision, ? FROM lots WHERE state <> 'open'",
            (utc_now(),),
        )


def due_lots(connection: sqlite3.Connection) -> dict[str, bool]:
    """Return the lots that were closed, voided or changed since their files were written, oldest first.

    True is a lot all of whose stones have an outcome.
    """
    rows = connection.execute(
        "SELECT lot, NOT EXISTS (SELECT 1 FROM triggers WHERE triggers.state = 'open' AND triggers.lot = lots.lot)"
        " FROM lots LEFT JOIN dropped_lots USING (lot)"
        " WHERE lots.state <> 'open' AND lots.revision > coalesce(dropped_lots.revision, 0) ORDER BY closed_at"
    )
    return {lot: bool(is_complete) for lot, is_complete in rows}


def note_dropped(connection: sqlite3.Connection, lot: str, files: LotFiles) -> None:
    """Note that the files of a revision are written."""
    connection.execute(
        "INSERT OR REPLACE INTO dropped_lots (lot, revision, at) VALUES (?, ?, ?)",
        (lot, files.revision, utc_now()),
    )


FOR_THE_PLANT = Purpose(check="file_drop", due=due_lots, note=note_dropped)
"""What `[file_drop]` asks for."""
