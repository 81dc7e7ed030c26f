"""Write events of the running daemon in the order in which they happen, without anyone waiting for the disk."""

import asyncio
import logging
import sqlite3
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

from service.base.errors import StoreError
from service.store.events import NewEvent, note_event
from service.store.store import POLL_S, Store

log = logging.getLogger(__name__)

MAX_WAITING = 1000
"""Changes that wait for the disk; of more, the oldest are given up."""

Write = Callable[[sqlite3.Connection], None]
"""Writes within a transaction that another one began."""
Change = tuple[Write | None, Sequence[NewEvent]]
"""Events, and what they change in the database."""


class EventLog:
    """Notes events, each with what it changes in the database. Call it on the event loop."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._waiting: deque[Change] = deque(maxlen=MAX_WAITING)
        self._writing: asyncio.Future[None] | None = None

    def note(self, *events: NewEvent, write: Write | None = None) -> None:
        """Write events, and what `write` changes, in one transaction, as soon as the disk takes it."""
        if len(self._waiting) == MAX_WAITING:
            given_up = [event.type for event in self._waiting[0][1]]
            log.error("events are given up, as the store is held: %s", ", ".join(given_up) or "no event")
        self._waiting.append((write, events))
        self._write_next()

    async def written(self, timeout_s: float | None = None) -> None:
        """Return when all that was noted is durable, or the store is held, or after a time."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while (writing := self._writing) is not None and self._store.trouble is None:
                    await asyncio.wait([writing], timeout=POLL_S)

    def _write_next(self) -> None:
        if self._writing is None and self._waiting:
            changes = tuple(self._waiting)
            self._waiting.clear()
            self._writing = self._store.write_later(_write_all, changes)
            self._writing.add_done_callback(self._finish)

    def _finish(self, written: "asyncio.Future[None]") -> None:
        self._writing = None
        error = None if written.cancelled() else written.exception()
        if isinstance(error, StoreError):  # the store was closed first
            log.error("events were not written: %s", error)
            return
        if error is not None:
            log.error("events were not written", exc_info=error)
        self._write_next()


def _write_all(connection: sqlite3.Connection, changes: Sequence[Change]) -> None:
    for write, events in changes:
        if write is not None:
            write(connection)
        for event in events:
            note_event(connection, event)
