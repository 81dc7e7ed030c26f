"""The one thread that writes to the database; a write that the disk refuses is repeated until it succeeds.

Writes are done in the order in which they were requested, so those behind a refused one wait for it. That is why all
places that write wait here and nowhere else, and why the callers bound how much can wait.
"""

import logging
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from service.base.errors import StoreError
from service.store.history import note_damage
from service.store.schema import connect
from service.store.trouble import StoreTrouble, TroubleCause, trouble_of

log = logging.getLogger(__name__)

T = TypeVar("T")

STALLED_S = 2.0
"""A write that takes longer means that the disk does not answer."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.05, 2.0
"""Pauses between two attempts of a refused write; each is twice as long as the one before."""


class StoreWriter:
    """Runs writes on a thread of its own, with its own connection; `trouble` says why they do not succeed."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="store-writer")
        self._connection: sqlite3.Connection | None = None
        self._closing = threading.Event()
        self._trouble: StoreTrouble | None = None
        self._began_s: float | None = None  # the write under way
        try:
            self._thread.submit(self._connect).result()
            self._inode = path.stat().st_ino
        except BaseException:
            self._thread.shutdown()
            raise

    @property
    def trouble(self) -> StoreTrouble | None:
        """Why nothing can be written now, None when all is well. Read it on any thread."""
        began_s = self._began_s
        if self._trouble is None and began_s is not None:
            waiting_s = time.monotonic() - began_s
            if waiting_s > STALLED_S:
                return StoreTrouble(TroubleCause.DISK, f"the disk has not answered for {waiting_s:.0f} s")
        return self._trouble

    def hold(self, trouble: StoreTrouble) -> None:
        """Record why nothing can be written; for good, if the database is damaged. Blocks; call it on any thread."""
        if self._is_damaged:
            return
        if self._trouble is None or trouble.cause is TroubleCause.DAMAGED:
            log.error("the store is held: %s", trouble)
        self._trouble = trouble
        if trouble.cause is TroubleCause.DAMAGED:
            note_damage(self._path.parent, trouble.detail)

    def submit(self, write: Callable[[sqlite3.Connection], T]) -> Future[T]:
        """Run `write` on the thread, again and again until the disk takes it; it must change all or nothing.

        The future raises `StoreError` for an error that is not the disk's, and when the writer is closed first.
        """
        return self._thread.submit(self._persist, write)

    def close(self) -> None:
        """Finish all writes that the disk takes, and give up the others."""
        self._closing.set()
        self._thread.submit(self._disconnect)
        self._thread.shutdown()

    # --- the thread ---

    def _persist(self, write: Callable[[sqlite3.Connection], T]) -> T:
        pause_s = FIRST_PAUSE_S
        self._began_s = time.monotonic()
        try:
            while True:
                try:
                    self._require_in_place()
                    if not self._is_damaged:
                        result = write(self._connect())
                        if self._trouble is not None:
                            log.warning("the store is written again, it was held: %s", self._trouble.detail)
                            self._trouble = None
                        return result
                except (sqlite3.Error, OSError, ValueError) as err:  # the last also of a damaged record
                    trouble = trouble_of(err)
                    if trouble is None:
                        if isinstance(err, ValueError):
                            raise
                        raise StoreError(f"{self._path}: {err}") from err
                    self.hold(trouble)
                if self._closing.wait(pause_s):
                    raise StoreError(f"{self._path}: {self._trouble}")
                self._disconnect()  # a connection opened while the file was read-only stays read-only
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        finally:
            self._began_s = None

    @property
    def _is_damaged(self) -> bool:
        return self._trouble is not None and self._trouble.cause is TroubleCause.DAMAGED

    def _require_in_place(self) -> None:
        """Hold for good when the open file is no longer the one of this name: what is written would be gone."""
        try:
            is_in_place = self._path.stat().st_ino == self._inode
        except FileNotFoundError:
            is_in_place = False
        if not is_in_place:
            self.hold(StoreTrouble(TroubleCause.DAMAGED, "the database file was removed or replaced"))

    def _connect(self) -> sqlite3.Connection:
        if self._connection is None:
            self._connection = connect(self._path)
        return self._connection

    def _disconnect(self) -> None:
        with suppress(sqlite3.Error):
            if self._connection is not None:
                self._connection.close()
        self._connection = None
