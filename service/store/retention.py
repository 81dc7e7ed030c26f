"""Retention: of each stone first its files are removed, and long afterwards its numbers.

The oldest go first, a few at a time. The row says so durably before the files are touched, so a kill in between
leaves nothing in doubt. Pinned results stay. Results that a consumer has not read yet stay for `consumer_days` longer.
"""

import sqlite3
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timedelta
from enum import StrEnum

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import TooManyError
from service.base.schema import Time, require_ranges, served
from service.store import audit
from service.store.events import CursorError
from service.store.schema import rows_by_name

STEP = 20
"""Results whose files, or rows, are removed at a time."""
LOOK = 50
"""Oldest results that are looked at for it."""
MOST = {"days": 36_500, "gb": 1_000_000, "percent": 100}
MAX_CONSUMERS = 100
FIRST_TIME = "2020"
"""Earlier times are of a clock that was not set, or unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RetentionLimits:
    """Limits of retention, each for itself; 0: no limit."""

    files_days: float = 0.0  # age of meshes, silhouettes, frames and pictures
    max_files_gb: float = 0.0  # size of meshes and silhouettes
    min_free_gb: float = 2.0  # free disk space, for which files are removed,
    min_free_percent: float = 0.0  # ... the same as a share of the disk
    results_days: float = 0.0  # age of results, without which the feed begins later
    consumer_days: float = 7.0  # how much longer results are kept for a consumer that has not read them
    recordings_days: float = 0.0  # age of recordings
    warn_days: float = 7.0  # health warns when the disk has room for less than this

    def __post_init__(self) -> None:
        require_ranges(self, **{each.name: (0, MOST[each.name.rpartition("_")[2]]) for each in fields(self)})
        if 0 < self.results_days < self.files_days:
            raise ValueError(
                f"files_days must not exceed results_days, {self.results_days:g}, not {self.files_days:g}"
            )

    @property
    def files_age_days(self) -> float:
        """Age at which files are removed: at the latest with their results; 0: never."""
        return self.files_days or self.results_days


@served
class ParkedCursor:
    """The place of a consumer, and since when."""

    name: str
    """Name that the consumer chose"""
    after: int
    """`seq` of the last result that it has"""
    moved_at: Time
    """When the cursor was parked, RFC 3339 UTC"""


@served
class ConsumerDocument(ParkedCursor):
    """A named reader of the feed, and its place there."""

    unread: int
    """Results since"""
    is_overrun: bool
    """True when results that it has not read were removed: `[store.retention] consumer_days`"""


@dataclass(frozen=True, slots=True)
class Disk:
    """Size and free space of the file system of the store."""

    total_bytes: int
    free_bytes: int

    def spare_bytes(self, limits: RetentionLimits) -> float:
        """Return the free space beyond what is to stay free; negative when too little is."""
        reserve_bytes = max(1e9 * limits.min_free_gb, limits.min_free_percent / 100 * self.total_bytes)
        return self.free_bytes - reserve_bytes


class Removed(StrEnum):
    """Why files of a result were removed."""

    AGE = "age"
    SPACE = "space"


def mark_files(connection: sqlite3.Connection, limits: RetentionLimits, disk: Disk, now: datetime) -> int:
    """Mark the oldest files that are due as removed; return of how many results."""
    rows = connection.execute(
        "SELECT seq, bytes, json_extract(record, '$.recorded_at') FROM files JOIN results USING (seq)"
        " WHERE removed IS NULL AND seq NOT IN (SELECT seq FROM pins) ORDER BY seq LIMIT ?",
        (LOOK,),
    ).fetchall()
    n_old = _n_older((row[2] for row in rows), limits.files_age_days, now)
    excess_bytes = _excess_bytes(connection, limits, disk)
    due = []
    for number, (seq, size, _) in enumerate(rows[:STEP]):
        if number >= n_old and excess_bytes <= 0:
            break
        due.append((Removed.AGE if number < n_old else Removed.SPACE, seq))
        excess_bytes -= size
    connection.executemany("UPDATE files SET removed = ? WHERE seq = ?", due)
    return len(due)


def files_going(connection: sqlite3.Connection) -> list[tuple[int, str]]:
    """Return number and folder of some results whose files are to be removed from the disk."""
    return connection.execute(
        "SELECT seq, folder FROM files WHERE removed IS NOT NULL AND bytes IS NOT NULL ORDER BY seq LIMIT ?",
        (STEP,),
    ).fetchall()


def note_gone(connection: sqlite3.Connection, seqs: Iterable[int]) -> None:
    """Record that the files of these results are gone from the disk."""
    connection.executemany("UPDATE files SET bytes = NULL WHERE seq = ?", ((seq,) for seq in seqs))


def remove_results(connection: sqlite3.Connection, limits: RetentionLimits, now: datetime) -> int:
    """Remove the oldest results that are due from the feed, and return how many.

    The newest result stays. A pinned one leaves the feed, which has no gaps, and is found by its id as before.
    """
    rows = connection.execute(
        "SELECT seq, json_extract(record, '$.recorded_at') FROM results, store"
        " WHERE seq >= first_seq AND seq < last_seq UNION ALL"
        " SELECT seq, json_extract(record, '$.recorded_at') FROM revisions, store"
        " WHERE seq >= first_seq AND seq < last_seq ORDER BY 1 LIMIT ?",
        (LOOK,),
    ).fetchall()
    (read_by_all,) = connection.execute("SELECT min(after_seq) FROM consumers").fetchone()
    n_read = sum(read_by_all is None or seq <= read_by_all for seq, _ in rows)
    times = [recorded_at for _, recorded_at in rows]
    n_due = min(_n_older(times, limits.results_days, now), n_read)
    if limits.results_days:  # also if no consumer reads them
        n_due = max(n_due, _n_older(times, limits.results_days + limits.consumer_days, now))
    due = rows[: min(n_due, STEP)]
    if due:
        connection.execute("UPDATE store SET first_seq = ?", (due[-1][0] + 1,))
    # the newest trigger stays, so that its number is not given again; files go before their row, and a result whose
    # revision is still in the feed after that
    connection.execute(
        "DELETE FROM results WHERE seq IN (SELECT seq FROM results, store WHERE seq < first_seq"
        " AND seq NOT IN (SELECT seq FROM pins) AND trigger < (SELECT max(trigger) FROM triggers)"
        " AND NOT EXISTS (SELECT 1 FROM revised WHERE first = results.seq AND revised.seq >= store.first_seq)"
        " AND NOT EXISTS (SELECT 1 FROM files WHERE files.seq = results.seq AND bytes IS NOT NULL) LIMIT ?)",
        (STEP,),
    )
    return len(due)


def is_older(time: str, days: float, now: datetime) -> bool:
    """True when a time is older than so many days; never for 0 days or an unknown time."""
    return _n_older([time], days, now) == 1


def _n_older(times: Iterable[str], days: float, now: datetime) -> int:
    """Count the leading times older than so many days; unknown ones count if a later one does."""
    if days == 0:
        return 0
    limit, n_older = rfc3339(now - timedelta(days=days)), 0
    for number, time in enumerate(times, start=1):
        if time >= limit:
            break
        if time > FIRST_TIME:
            n_older = number
    return n_older


def _excess_bytes(connection: sqlite3.Connection, limits: RetentionLimits, disk: Disk) -> float:
    """Return the bytes of files beyond the limits, those that are being removed not counted."""
    (going_bytes,) = connection.execute(
        "SELECT total(bytes) FROM files WHERE removed IS NOT NULL AND bytes IS NOT NULL"
    ).fetchone()
    (files_bytes,) = connection.execute("SELECT files_bytes FROM store").fetchone()
    beyond_bytes = files_bytes - 1e9 * limits.max_files_gb if limits.max_files_gb else 0.0
    return float(max(beyond_bytes, -disk.spare_bytes(limits)) - going_bytes)


def pin(connection: sqlite3.Connection, seq: int, reason: str | None, who: str) -> None:
    """Pin a result for this reason, or no longer for None; one that was removed meanwhile stays so."""
    before = _pin_of(connection, seq)
    connection.execute("DELETE FROM pins WHERE seq = ?", (seq,))
    if reason is not None:
        connection.execute("INSERT INTO pins SELECT seq, ? FROM results WHERE seq = ?", (reason, seq))
    after = _pin_of(connection, seq)
    if after != before:
        action = "particle unpinned" if after is None else "particle pinned"
        audit.note(connection, who, action, str(seq), before=before, after=after)


def _pin_of(connection: sqlite3.Connection, seq: int) -> dict[str, str] | None:
    row = connection.execute("SELECT reason FROM pins WHERE seq = ?", (seq,)).fetchone()
    return None if row is None else {"reason": row[0]}


def park(connection: sqlite3.Connection, name: str, after: int) -> ConsumerDocument:
    """Note that a consumer has read up to `after`; return the consumer.

    Raises `CursorError` if the feed is not there yet, or no longer; `TooManyError` beyond `MAX_CONSUMERS`.
    """
    first_seq, last_seq = connection.execute("SELECT first_seq, last_seq FROM store").fetchone()
    if not first_seq - 1 <= after <= last_seq:
        problem = f"results {first_seq} to {last_seq} are kept: a cursor cannot be at {after}"
        raise CursorError(problem, after, first_seq, last_seq)
    connection.execute("INSERT OR REPLACE INTO consumers VALUES (?, ?, ?)", (name, after, utc_now()))
    (n,) = connection.execute("SELECT count(*) FROM consumers").fetchone()
    if n > MAX_CONSUMERS:
        raise TooManyError("consumers", f"there are {MAX_CONSUMERS} consumers: delete one of them")
    return next(consumer for consumer in consumers(connection) if consumer.name == name)


def consumers(connection: sqlite3.Connection) -> list[ConsumerDocument]:
    """Return all consumers, by name."""
    rows = connection.execute(
        "SELECT name, after_seq AS after, moved_at, last_seq - after_seq AS unread,"
        " after_seq < first_seq - 1 AS is_overrun FROM consumers, store ORDER BY name"
    )
    return [ConsumerDocument(**row | {"is_overrun": bool(row["is_overrun"])}) for row in rows_by_name(rows)]


def forget(connection: sqlite3.Connection, name: str, who: str) -> bool:
    """Delete a consumer; return whether there was one."""
    before = next((each for each in consumers(connection) if each.name == name), None)
    if before is None:
        return False
    connection.execute("DELETE FROM consumers WHERE name = ?", (name,))
    audit.note(connection, who, "consumer deleted", name, before=asdict(before))
    return True
