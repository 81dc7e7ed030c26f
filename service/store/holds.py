"""What retention must not take: pinned results, and for a time what a consumer has not read."""

import sqlite3
from dataclasses import asdict, dataclass

from drivers.files.times import utc_now
from service.base.errors import TooManyError
from service.store import audit
from service.store.events import CursorError

MAX_CONSUMERS = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Consumer:
    """A named client of the feed."""

    name: str
    after: int  # last result that it has
    moved_at: str  # RFC 3339
    unread: int
    is_overrun: bool  # results that it has not read were removed


def pin(connection: sqlite3.Connection, seq: int, reason: str | None, who: str) -> None:
    """Pin a result for this reason, or no longer for None; one that was removed meanwhile stays so."""
    before = _pin_of(connection, seq)
    connection.execute("DELETE FROM pins WHERE seq = ?", (seq,))
    if reason is not None:
        connection.execute(
            "INSERT INTO pins SELECT seq, ? FROM results WHERE seq = ?",
            (reason, seq),
        )
    after = _pin_of(connection, seq)
    if after != before:
        action = "particle unpinned" if after is None else "particle pinned"
        audit.note(connection, who, action, str(seq), before=before, after=after)


def _pin_of(connection: sqlite3.Connection, seq: int) -> dict[str, str] | None:
    row = connection.execute("SELECT reason FROM pins WHERE seq = ?", (seq,)).fetchone()
    return None if row is None else {"reason": row[0]}


def park(connection: sqlite3.Connection, name: str, after: int) -> Consumer:
    """Note that a consumer has read up to `after`; return the consumer.

    Raises
    ------
    CursorError
        The feed is not there yet, or no longer.
    TooManyError
        There are `MAX_CONSUMERS` already.
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


def consumers(connection: sqlite3.Connection) -> list[Consumer]:
    """Return all consumers, by name."""
    rows = connection.execute(
        "SELECT name, after_seq, moved_at, last_seq - after_seq, after_seq < first_seq - 1"
        " FROM consumers, store ORDER BY name"
    )
    return [
        Consumer(name=name, after=after, moved_at=moved_at, unread=unread, is_overrun=bool(is_overrun))
        for name, after, moved_at, unread, is_overrun in rows
    ]


def forget(connection: sqlite3.Connection, name: str, who: str) -> bool:
    """Delete a consumer; return whether there was one."""
    before = next((each for each in consumers(connection) if each.name == name), None)
    if before is None:
        return False
    connection.execute("DELETE FROM consumers WHERE name = ?", (name,))
    audit.note(connection, who, "consumer deleted", name, before=asdict(before))
    return True
