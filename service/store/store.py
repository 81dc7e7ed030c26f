"""The result store: one thread writes, others read, and tasks that wait for results are woken by each commit.

`open_store` and `close` block; everything else is for the event loop. A write is durable when it returns.
"""

import asyncio
import fcntl
import sqlite3
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from drivers.files.durable import sync
from pipeline.frames import Trigger
from service.errors import StoreError
from service.results.fields import LossReason
from service.store import reads, writes
from service.store.accounting import Accounting
from service.store.particle_files import drop_raw, raw_frames
from service.store.schema import connect_reader, connect_writer

P = ParamSpec("P")
T = TypeVar("T")


KEEP_RAW = 200
"""Newest results whose raw frames are kept; they take about 9 MB each."""
NOTE_EVERY = 100
"""Results between two notes in the database of how far raw frames were removed."""
READERS = 2
"""Queries at a time: those of a hundred clients do not slow down the measuring."""


def open_store(state_dir: Path, *, keep_raw: int = KEEP_RAW) -> "Store":
    """Open `state_dir/results.sqlite`, creating what is missing.

    The raw frames, `bundle.tiff`, of the newest `keep_raw` results are kept.

    Raises
    ------
    StoreError
        Another process has the store open, the file is no database, or its schema is newer than this program.
    """
    try:
        (state_dir / "particles").mkdir(parents=True, exist_ok=True)
        sync(state_dir)
        lock = FileIO(state_dir / "store.lock", "w")
    except OSError as err:
        raise StoreError(f"{state_dir}: {err}") from err
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as err:
        lock.close()
        raise StoreError(
            f"{state_dir}: another process has the store open: stop it, or choose another store.dir"
        ) from err
    writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="store-writer")
    try:
        connection = writer.submit(connect_writer, state_dir / "results.sqlite").result()
    except StoreError:
        writer.shutdown()
        lock.close()
        raise
    return Store(state_dir, lock, writer, connection, keep_raw)


class Store:
    """Triggers, their outcomes and the files of the particles; created by `open_store`."""

    def __init__(
        self,
        state_dir: Path,
        lock: FileIO,
        writer: ThreadPoolExecutor,
        connection: sqlite3.Connection,
        keep_raw: int,
    ) -> None:
        self.particles_dir = state_dir / "particles"
        self._path = state_dir / "results.sqlite"
        self._lock = lock  # held until the process ends or `close`
        self._writer = writer
        self._connection = connection  # used by the writer thread alone
        self._session: int | None = None
        self._committed = asyncio.Event()  # replaced at each commit
        self._released = False
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix="store-reader")
        with connect_reader(self._path) as reader:
            row = reader.execute("SELECT instance_id, last_seq, first_raw FROM store").fetchone()
        self._instance_id: str = row[0]
        self._last_seq: int = row[1]
        self._first_raw: int = row[2]  # results before this one have no raw frames
        self._keep_raw = keep_raw

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Finish all writes, then close the database."""
        self._readers.shutdown(cancel_futures=True)
        self._writer.submit(self._connection.close)
        self._writer.shutdown()
        self._lock.close()

    @property
    def instance_id(self) -> str:
        """UUID of this history; clients that see another one start the feed again."""
        return self._instance_id

    @property
    def last_seq(self) -> int:
        """Number of the newest durable result; 0 before the first."""
        return self._last_seq

    @property
    def session(self) -> int | None:
        """Number of the session begun by this process, None before `begin_session`."""
        return self._session

    async def begin_session(self, info: Mapping[str, Any]) -> int:
        """Begin a session, a run of the daemon, and return its number; `info` (JSON) describes it.

        Its `calibration_id` and `is_simulated` go into the records of triggers that a crash leaves open.
        """
        self._session = await self._write(writes.begin_session, info)
        return self._session

    async def note_calibration(self, session: int, calibration_id: str) -> None:
        """Record that the session uses another calibration from now on."""
        await self._write(writes.note_calibration, session, calibration_id)

    async def record_triggers(self, session: int, triggers: Mapping[str, Trigger]) -> None:
        """Record triggers durably, by the names of their bundles, which are unique within the session."""
        await self._write(writes.record_triggers, session, triggers)

    async def finish(
        self, session: int, bundle: str, record: Mapping[str, Any], files: Mapping[str, Path] | None = None
    ) -> int:
        """End a trigger with `record` and return the result's `seq`.

        `files` (by name, such as `mesh.ply`) are moved to `particles/<id>/` first. A second outcome for the same
        trigger changes nothing, and the `seq` of the first is returned.
        """
        return await self._write(writes.finish, self.particles_dir, session, bundle, record, files or {})

    def raw_path(self, seq: int) -> Path:
        """Return where to write the raw frames of a result; call `drop_old_raw` afterwards."""
        return raw_frames(self.particles_dir, self._instance_id, seq)

    async def drop_old_raw(self, seq: int) -> None:
        """Remove the raw frames of a result unless it is among the newest `keep_raw`."""
        if seq <= self._last_seq - self._keep_raw:
            await asyncio.to_thread(drop_raw, self.particles_dir, self._instance_id, seq)

    async def lose_open(self, reason: LossReason, detail: str) -> int:
        """End as `lost` every trigger that an earlier session left open; return how many these were."""
        return await self._write(writes.lose_open, self.particles_dir, self._session, reason, detail)

    async def accounting(self, session: int | None = None) -> Accounting:
        """Return the counts of one session, or of the whole history."""
        return await self._read(reads.accounting, session)

    async def results_after(self, seq: int, limit: int) -> reads.ResultPage:
        """Return up to `limit` results after `seq`, in order."""
        return await self._read(reads.results_after, seq, limit)

    async def particle(self, key: str | int) -> reads.Record | None:
        """Return one result by id (text) or seq (number), None if there is none."""
        return await self._read(reads.particle, key)

    async def particles(
        self, wanted: reads.ParticleFilter, before_seq: int | None, limit: int
    ) -> list[reads.Record]:
        """Return the newest `limit` results that fit and are older than `before_seq`, newest first."""
        return await self._read(reads.particles, wanted, before_seq, limit)

    async def wait_beyond(self, seq: int) -> None:
        """Return when a result after `seq` is durable, or when waiting was ended by `release_waiters`."""
        while self._last_seq <= seq and not self._released:
            await self._committed.wait()

    def release_waiters(self) -> None:
        """End all waiting in `wait_beyond` for good, because the daemon is about to stop."""
        self._released = True
        self._wake()

    def _wake(self) -> None:
        self._committed.set()
        self._committed = asyncio.Event()

    async def _write(
        self, work: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        def job() -> T:
            try:
                result = work(self._connection, *args, **kwargs)
                (self._last_seq,) = self._connection.execute("SELECT last_seq FROM store").fetchone()
                self._drop_old_raw()
            except (sqlite3.Error, OSError) as err:
                raise StoreError(f"{self._path}: {err}") from err
            return result

        written = asyncio.wrap_future(self._writer.submit(job))
        # on the inner future, and shielded: waiting readers must be woken even if the caller is cancelled meanwhile
        written.add_done_callback(lambda _: self._wake())
        return await asyncio.shield(written)

    def _drop_old_raw(self) -> None:
        first_raw_before, first_kept = self._first_raw, self._last_seq - self._keep_raw + 1
        for seq in range(first_raw_before, first_kept):
            drop_raw(self.particles_dir, self._instance_id, seq)
        self._first_raw = max(first_raw_before, first_kept)
        if self._first_raw // NOTE_EVERY > first_raw_before // NOTE_EVERY:
            writes.note_first_raw(self._connection, self._first_raw)

    async def _read(
        self, query: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        def job() -> T:
            try:
                with connect_reader(self._path) as connection:
                    return query(connection, *args, **kwargs)
            except sqlite3.Error as err:
                raise StoreError(f"{self._path}: {err}") from err

        return await asyncio.get_running_loop().run_in_executor(self._readers, job)
