"""Queries on a read-only connection, and the types that they return."""

import json
import sqlite3
from collections.abc import Iterable
from typing import Any

from pipeline.frames import GateCount
from service.results.fields import completed
from service.store.events import HistoryPage
from service.store.particle_files import revision_folder
from service.store.particle_filter import ParticleFilter, conditions_of
from service.store.schema import rows_by_name

Record = dict[str, Any]
"""A result as stored: the fields of `service.results.fields.Result`, and any other key."""


STATE = (
    " JOIN triggers ON triggers.trigger = results.trigger LEFT JOIN files ON files.seq = results.seq"
    " LEFT JOIN pins ON pins.seq = results.seq"
)
"""What has happened to the stone of a result since."""
FIRST = f"SELECT results.seq, results.record, removed, pins.reason, triggers.lot FROM results{STATE}"  # noqa: S608 - constants, as below
"""Results as they first were."""
LATER = (
    "SELECT revisions.seq, revisions.record, removed, pins.reason, triggers.lot"  # noqa: S608 - as above
    f" FROM revisions JOIN results ON results.seq = revisions.first{STATE}"
)
"""Their revisions."""
NEWEST = (
    "SELECT seq, record, removed, pins.reason, lot"
    " FROM newest_records LEFT JOIN files USING (seq) LEFT JOIN pins USING (seq)"
)
"""The newest revision of each result."""
HAS_RESULT = "(lot IS NULL OR EXISTS (SELECT 1 FROM listed WHERE listed.seq = indexed_fields.seq))"
"""Rows of `indexed_fields` but those of stones in lots whose results were removed."""


def open_triggers(
    connection: sqlite3.Connection, live_session: int | None, among: Iterable[tuple[int, str]]
) -> list[tuple[int, str]]:
    """Return in their order the open triggers `among` some, by session and bundle, but those of `live_session`."""
    found: list[tuple[int, int, str]] = []
    for session, bundle in among:
        found += connection.execute(
            "SELECT trigger, session, bundle FROM triggers"
            " WHERE session = ?1 AND bundle = ?2 AND state = 'open' AND session IS NOT ?3",
            (session, bundle, live_session),
        )
    return [(session, bundle) for _, session, bundle in sorted(found)]


def gate_count(connection: sqlite3.Connection) -> tuple[GateCount, int] | None:
    """Return the gate's count noted last, and the number of stones recorded since; None if there is nothing to miss.

    A session that noted none, not even that the gate was disarmed, has not heard of the gate.
    """
    row = connection.execute(
        "SELECT json_extract(info, '$.gate_count') FROM sessions"
        " WHERE json_type(info, '$.gate_count') IS NOT NULL ORDER BY session DESC LIMIT 1"
    ).fetchone()
    if row is None or row[0] is None:
        return None
    noted = json.loads(row[0])
    newest = noted.pop("trigger")
    (n_since,) = connection.execute("SELECT total(n) FROM triggers WHERE trigger > ?", (newest,)).fetchone()
    (at,) = connection.execute(
        "SELECT max(captured_at) FROM triggers WHERE trigger = ?", (newest,)
    ).fetchone()
    return GateCount(**noted, at=at), int(n_since)


def results_after(connection: sqlite3.Connection, seq: int, limit: int) -> HistoryPage:
    """Return up to `limit` results after `seq`, in order."""
    last_seq, first_seq = connection.execute(
        "SELECT last_seq, min("
        "coalesce((SELECT min(seq) FROM results WHERE seq >= first_seq), last_seq + 1), "
        "coalesce((SELECT min(seq) FROM revisions WHERE seq >= first_seq), last_seq + 1)) FROM store"
    ).fetchone()
    rows = connection.execute(
        f"{FIRST} WHERE results.seq > ?1 UNION ALL {LATER} WHERE revisions.seq > ?1 ORDER BY 1 LIMIT ?2",
        (seq, limit),
    ).fetchall()
    return HistoryPage(first_seq=first_seq, last_seq=last_seq, items=[_record(*row) for row in rows])


def seq_before(connection: sqlite3.Connection, recorded_at: str) -> int:
    """Return the number before the first result that became durable at or after a time; the last one without any."""
    row = connection.execute(
        "SELECT coalesce(min(seq) - 1, (SELECT last_seq FROM store)) FROM ("
        "SELECT min(seq) AS seq FROM results WHERE json_extract(record, '$.recorded_at') >= ?1 UNION ALL "
        "SELECT min(seq) FROM revisions WHERE json_extract(record, '$.recorded_at') >= ?1)",
        (recorded_at,),
    ).fetchone()
    return int(row[0])


def particle(connection: sqlite3.Connection, key: str | int) -> Record | None:
    """Return the newest revision of the result with this id (text), or the item with this seq (number), or None."""
    if isinstance(key, int):
        query = f"{FIRST} WHERE results.seq = ?1 UNION ALL {LATER} WHERE revisions.seq = ?1"
    else:
        query = f"{NEWEST} WHERE id = ?1"
    row = connection.execute(query, (key,)).fetchone()
    return _record(*row) if row else None


def folder(connection: sqlite3.Connection, seq: int) -> str | None:
    """Return where the files of a result or revision are, below `particles`; None if it never had any."""
    row = connection.execute(
        "SELECT folder, 1 FROM files WHERE seq = ?1 UNION ALL"
        " SELECT folder, revision FROM revisions JOIN files ON files.seq = first WHERE revisions.seq = ?1",
        (seq,),
    ).fetchone()
    return revision_folder(*row) if row else None


def newest_folder(connection: sqlite3.Connection, first: int) -> str | None:
    """Return where the files of a stone's newest revision are; `first` is the seq of its first result."""
    row = connection.execute("SELECT seq FROM revised WHERE first = ?", (first,)).fetchone()
    return folder(connection, row[0] if row else first)


def particles(
    connection: sqlite3.Connection, wanted: ParticleFilter, before_seq: int | None, limit: int
) -> list[Record]:
    """Return the newest `limit` stones that fit and first came before `before_seq`, each in its newest revision."""
    conditions = dict(conditions_of(wanted))
    conditions["seq < ?"] = before_seq
    given = {text: value for text, value in conditions.items() if value is not None}
    rows = connection.execute(
        f"{NEWEST} WHERE seq IN ("  # noqa: S608 - conditions are those of the fields
        f"SELECT seq FROM indexed_fields WHERE {' AND '.join((*given, HAS_RESULT))} ORDER BY seq DESC LIMIT ?"
        ") ORDER BY seq DESC",
        (*given.values(), limit),
    ).fetchall()
    return [_record(*row) for row in rows]


def stones_after(
    connection: sqlite3.Connection, lot: str, after: int, limit: int
) -> list[tuple[int, Record]]:
    """Return the next stones of a lot by the `seq` of their first results, each with its newest record.

    Of a result that was removed the indexed fields are left.
    """
    rows = connection.execute(
        "SELECT * FROM stones WHERE lot = ? AND seq > ? ORDER BY seq LIMIT ?", (lot, after, limit)
    )
    indexed = rows_by_name(rows)
    newest = connection.execute(
        f"{NEWEST} WHERE seq IN (SELECT value FROM json_each(?))",  # noqa: S608 - constants
        (json.dumps([row["seq"] for row in indexed]),),
    )
    records = {row[0]: completed(_record(*row)) for row in newest}
    return [(row["seq"], records.get(row["seq"], row)) for row in indexed]


def _record(seq: int, text: str, removed: str | None, pin_reason: str | None, lot: str | None) -> Record:
    """Return the record as it was stored, with what has happened to it since."""
    record: Record = json.loads(text)
    return record | {
        "lot": lot,
        "files_removed": removed,
        "is_pinned": pin_reason is not None,
        "pin_reason": pin_reason,
    }
