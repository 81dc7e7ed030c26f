"""The result store: one thread writes, others read, and tasks that wait for results are woken by each commit.

`open_store` and `close` block; everything else is for the event loop. A result is durable when `finish` returns. While
the disk refuses to write, the store is held: `finish` waits, triggers are recorded with their outcomes later.
"""

import asyncio
import logging
import os
import sqlite3
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from drivers.files.durable import sync
from pipeline.frames import GateCount, Trigger
from service.base import aside
from service.base.errors import StoreError
from service.results.fields import Result
from service.store import audit, backups, history, reads, writes
from service.store.particle_files import RAW, drop_raw, drop_sources, particle_id, path_of
from service.store.schema import lock_store, read, reader_of, transaction
from service.store.trouble import StoreTrouble, TroubleCause, trouble_of
from service.store.writer import StoreWriter

log = logging.getLogger(__name__)

P = ParamSpec("P")
T = TypeVar("T")


KEEP_RAW = 200
"""Newest results whose raw frames are kept; they take about 9 MB each."""
POLL_S = 0.05
"""Time between two looks at whether the disk refuses to write."""
MAX_NOTES = 1000
"""Entries of the audit that wait for a disk that refuses to write; more are in the log alone."""
READERS = 2
"""Queries at a time: those of a hundred clients do not slow down the measuring."""


def open_store(state_dir: Path, *, keep_raw: int = KEEP_RAW) -> "Store":
    """Open `state_dir/results.sqlite`, creating what is missing; a damaged one is moved aside (`store.history`).

    The raw frames, `bundle.tiff`, of the newest `keep_raw` results are kept.

    Raises `StoreError` if another process has it open, its schema is newer than this program, or the disk refuses.
    """
    try:
        (state_dir / history.PARTICLES).mkdir(parents=True, exist_ok=True)
        sync(state_dir)
        lock = lock_store(state_dir)
    except OSError as err:
        raise StoreError(f"{state_dir}: {err}") from err
    try:
        history.open_history(state_dir)
        return Store(state_dir, lock, StoreWriter(state_dir / history.DATABASE), keep_raw)
    except BaseException as err:
        os.close(lock)
        if not isinstance(err, (sqlite3.Error, OSError, StoreError, ValueError)):
            raise
        raise StoreError(f"{state_dir / history.DATABASE}: {err}") from err


class Store:
    """Triggers, their outcomes and the files of the particles; created by `open_store`."""

    def __init__(self, state_dir: Path, lock: int, writer: StoreWriter, keep_raw: int) -> None:
        self.particles_dir = state_dir / history.PARTICLES
        self.dir = state_dir
        self.path = state_dir / history.DATABASE
        self._lock = lock  # held until the process ends or `close`
        self._writer = writer
        self._committed = asyncio.Event()  # replaced at each commit
        self._notes: set[asyncio.Future[None]] = set()  # entries of the audit that are not written yet
        self._n_digests = len(audit.kept_digests(state_dir))
        self._keep_raw = keep_raw
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix="store-reader")
        self.session: int | None = None
        """Number of the session begun by this process, None before `begin_session`."""
        self.is_released = False
        """True while stopping: long polls return at once."""
        self._reader_here = reader_of(self.path)
        self._reader_here.execute("PRAGMA busy_timeout = 0")
        row = self._reader_here.execute(
            "SELECT instance_id, last_seq, last_event, first_raw FROM store"
        ).fetchone()
        self.instance_id: str = row[0]
        """UUID of this history; clients that see another one start the feed again."""
        self.last_seq: int = row[1]
        """Number of the newest durable result; 0 before the first."""
        self.last_event: int = row[2]
        """Number of the newest durable event; 0 before the first."""
        self._first_raw: int = row[3]  # results before this one have no raw frames

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Finish all writes that the disk takes, then close the database."""
        self._readers.shutdown(cancel_futures=True)
        self._reader_here.close()
        self._writer.close()
        os.close(self._lock)

    @property
    def trouble(self) -> StoreTrouble | None:
        """Why the store is held: nothing can be written, or the database is damaged; None when it is not."""
        return self._writer.trouble

    def require_writable(self) -> None:
        """Raise `StoreError` while the store is held, so that a client need not wait."""
        if (trouble := self.trouble) is not None:
            raise StoreError(str(trouble))

    @property
    def incidents(self) -> list[str]:
        """Notes on what was moved aside at a start, because the database was damaged or had lost results."""
        return aside.incidents(self.dir)

    async def begin_session(self, info: Mapping[str, Any]) -> int:
        """Begin a session, a run of the daemon, and return its number; `info` (JSON) describes it.

        Its `calibration_id` and `is_simulated` go into the records of triggers that a crash leaves open.
        """
        self.session = await self.write(writes.begin_session, info)
        return self.session

    async def record_triggers(
        self, session: int, triggers: Mapping[str, Trigger], gate_count: GateCount | None = None
    ) -> None:
        """Record triggers durably, by the names of their bundles, which are unique within the session.

        While the store is held they are not: `finish` records each with its outcome, so nothing waits in between.
        `gate_count` is the gate's at the last of them, if everything that it counted before is recorded.
        """
        if self.trouble is None:
            await self.write_soon(writes.record_triggers, session, triggers, gate_count)

    async def forget_gate_count(self, session: int) -> None:
        """Record that nothing is missed of what the gate counts from now on, as it was disarmed."""
        await self.write_soon(writes.note_gate_count, session, None)

    async def note_change(
        self,
        who: str,
        action: str,
        subject: str,
        *,
        before: Mapping[str, Any] | None = None,
        after: Mapping[str, Any] | None = None,
    ) -> None:
        """Note in the audit what was changed outside of the database, unless nothing was.

        Call it right after the change. It waits for no store that is held: the entry is written later, and logged.
        """
        if before == after:
            return
        if self.trouble is not None:
            log.warning("the audit waits for the store: %s %s, by %s: %s", action, subject, who, after)
            if len(self._notes) >= MAX_NOTES:
                return
        written = self.write_later(audit.note, who, action, subject, before=before, after=after)
        self._notes.add(written)
        written.add_done_callback(self._notes.discard)
        await self._unless_held(written)

    async def finish(
        self, session: int, bundle: str, record: Result, files: Mapping[str, Path] | None = None
    ) -> int:
        """End a trigger with `record` and return the result's `seq`.

        `files` (by name, such as `mesh.ply`) are moved to a folder of `particles` first. A second outcome for the same
        trigger changes nothing, and the `seq` of the first is returned. Waits as long as the store is held.
        """
        files = files or {}
        seq, is_new = await self.write(writes.finish, self.particles_dir, session, bundle, record, files)
        if is_new:
            drop_sources(files)
        name = particle_id(self.instance_id, seq)
        log.debug("%s seq=%d stone_id=%s session=%d bundle=%s", record.outcome, seq, name, session, bundle)
        return seq

    async def folder(self, seq: int) -> Path:
        """Return where the files of a result are, or would be; it need not exist."""
        folder = await self.read(reads.folder, seq)
        return path_of(self.particles_dir, folder) if folder else self.particles_dir / str(seq)

    async def raw_path(self, seq: int) -> Path:
        """Return where to write the raw frames of a new result; call `drop_old_raw` afterwards."""
        return await self.folder(seq) / RAW

    async def drop_old_raw(self, seq: int) -> None:
        """Remove the raw frames of a result unless it is among the newest `keep_raw`."""
        if seq < self._first_raw:
            with suppress(OSError):  # a disk that is read-only now
                await asyncio.to_thread(drop_raw, await self.folder(seq))

    async def back_up(self, keep: int) -> Path:
        """Copy the database, check the copy and keep the newest `keep` of them; return the new one.

        Raises `StoreError` if there is no room, or the database is damaged: then the store is held from now on.
        """
        target = backups.backup_path(self.dir)
        try:
            await asyncio.to_thread(backups.back_up, self.dir, target, lambda: not self.is_released)
        except backups.DamagedStoreError as err:
            await asyncio.to_thread(self._writer.hold, StoreTrouble(TroubleCause.DAMAGED, str(err)))
            raise
        await asyncio.to_thread(backups.prune, self.dir, keep, target)
        return target

    async def wait_while(self, is_awaited: Callable[[], bool]) -> None:
        """Wait from commit to commit while this is true, or until waiting was ended by `release_waiters`."""
        while is_awaited() and not self.is_released:
            await self._committed.wait()

    async def wait_for_event(self, seen: int) -> None:
        """Wait until there is an event after number `seen`, or until waiting was ended."""
        await self.wait_while(lambda: self.last_event <= seen)

    def release_waiters(self) -> None:
        """End all waiting in `wait_while` for good, because the daemon is about to stop."""
        self.is_released = True
        self._wake()

    def _wake(self, written: "asyncio.Future[Any] | None" = None) -> None:
        if written is not None and not written.cancelled():
            written.exception()  # the caller may be gone
        self._committed.set()
        self._committed = asyncio.Event()

    async def write(
        self, work: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Return `work(connection, ...)`, one transaction in the thread that writes; waits while the store is held."""
        return await asyncio.shield(self.write_later(work, *args, **kwargs))

    async def write_soon(
        self, work: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> None:
        """Write, but do not wait for a disk that refuses or does not answer: all later writes come after this one."""
        await self._unless_held(self.write_later(work, *args, **kwargs))

    async def _unless_held(self, written: "asyncio.Future[T]") -> None:
        """Wait until something is written, or the disk refuses or does not answer."""
        while not written.done() and self.trouble is None:
            await asyncio.wait([written], timeout=POLL_S)
        if written.done():
            written.result()

    def write_later(
        self, work: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> "asyncio.Future[T]":
        """Queue `work(connection, ...)` after all earlier writes; the caller bounds the number that wait."""

        def write(connection: sqlite3.Connection) -> T:
            try:
                with transaction(connection):
                    result = work(connection, *args, **kwargs)
            except StopIteration as err:  # as `read` has it
                raise RuntimeError(f"{work}: nothing was left to take") from err
            self._note_newest(connection)
            return result

        written = asyncio.wrap_future(self._writer.submit(write))
        # on the inner future: waiting readers must be woken even if the caller is cancelled meanwhile
        written.add_done_callback(self._wake)
        return written

    def _note_newest(self, connection: sqlite3.Connection) -> None:
        """Note the newest result, event and entry of the audit, and remove raw frames that are too old.

        The disk may refuse until the next time.
        """
        with suppress(sqlite3.Error, OSError, StoreError):
            self._n_digests = audit.keep_digests(connection, self.dir, self._n_digests)
            last_seq, self.last_event = connection.execute(
                "SELECT last_seq, last_event FROM store"
            ).fetchone()
            if last_seq != self.last_seq:
                self.last_seq = last_seq
                history.acknowledge(self.dir, self.instance_id, last_seq)
            first_kept = writes.first_with_frames(connection, self._keep_raw)
            if first_kept > self._first_raw:
                writes.drop_old_raw(connection, self.particles_dir, self._first_raw, first_kept)
                self._first_raw = first_kept

    async def read(
        self, query: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Return `query(connection, ...)`, made in a thread of the store on a read-only connection."""
        run = asyncio.get_running_loop().run_in_executor
        try:
            return await run(self._readers, partial(read, self.path, query, *args, **kwargs))
        except StoreError as err:
            trouble = trouble_of(err.__cause__) if isinstance(err.__cause__, Exception) else None
            if trouble is not None and trouble.cause is TroubleCause.DAMAGED:
                await run(self._readers, self._writer.hold, trouble)
            raise

    def read_here(self, query: Callable[[sqlite3.Connection], T]) -> T:
        """Return `query(connection)`, made on the event loop itself: only for what takes microseconds."""
        try:
            return query(self._reader_here)
        except (sqlite3.Error, ValueError) as err:
            raise StoreError(f"{self.path}: {err}") from err
