"""The audit trail: changes and their authors, in their order; never edited.

A change of the database is noted in its own transaction, any other right after it was made. The digests of the entries
are a chain: an entry that was edited or removed breaks it. Each digest is kept in a file beside the database as well,
so that a chain that was made anew, or has lost its end, shows beside what it was.
"""

import hashlib
import json
import os
import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from drivers.files.times import utc_now
from service.base.csv_text import csv_text
from service.base.redaction import redacted
from service.base.schema import Time, served

CONFIGURATION = "configuration"
"""Action of the entries about the file of settings, whose URLs earlier versions kept to the end."""
PAGE = 1000
"""Entries that are read at a time while all are rewritten."""
DIGESTS = "audit-digests"
"""File beside the database: the digest of each entry, a line each, in their order."""
LINE = re.compile(rb"([0-9a-f]{64})\n")
LINE_BYTES = 65
N_NEWEST = 1000
"""Newest digests that are compared at each start."""


@served
class AuditEntry:
    """One change; never edited."""

    entry: int
    """Number of the entry, in the order of the changes."""
    at: Time
    """When it was changed, RFC 3339 UTC."""
    who: str
    """Name of the key, or `this machine` while there is none."""
    action: str
    """Such as `lot opened`, `calibration activated`, `acquisition disarmed`."""
    subject: str
    """What was changed, such as the id of a lot."""
    before: Mapping[str, Any] | None
    """State before the change; null when there was nothing."""
    after: Mapping[str, Any] | None
    """State after the change; null when there is nothing."""
    digest: str | None
    """SHA-256 of the digest before and of this entry, which makes the entries a chain; null in those of
    earlier versions."""


COLUMNS = tuple(field.name for field in fields(AuditEntry))


@dataclass(frozen=True, slots=True)
class Chain:
    """State of the chain of digests over all entries."""

    n_entries: int
    digest: str  # of the last one, empty without any
    broken_at: int | None  # first entry that does not fit those before it


def note(
    connection: sqlite3.Connection,
    who: str,
    action: str,
    subject: str,
    *,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
) -> None:
    """Note a change within the transaction that makes it, or alone if it was made elsewhere."""
    newest = connection.execute("SELECT entry, digest FROM audit ORDER BY entry DESC LIMIT 1").fetchone()
    last, digest = newest or (0, "")
    if digest is None:  # entries of earlier versions get theirs only now
        digest = check_chain(connection).digest
    row = (last + 1, utc_now(), who, action, subject, _text(before), _text(after))
    connection.execute("INSERT INTO audit VALUES (?, ?, ?, ?, ?, ?, ?, ?)", (*row, next_digest(digest, row)))


def next_digest(digest: str, row: tuple[object, ...]) -> str:
    """Return the digest of an entry: SHA-256 of the one before and, as JSON, its columns from `entry` to `after`."""
    return hashlib.sha256(f"{digest}{json.dumps(row, ensure_ascii=False)}".encode()).hexdigest()


def kept_digests(folder: Path) -> list[str]:
    """Return the digests kept beside the database, in the order of the entries; "" for one that is not known."""
    try:
        content = (folder / DIGESTS).read_bytes()
    except FileNotFoundError:
        return []
    lines = (content[at : at + LINE_BYTES] for at in range(0, len(content), LINE_BYTES))
    return [line[:-1].decode() if LINE.fullmatch(line) else "" for line in lines]


def keep_digests(connection: sqlite3.Connection, folder: Path, n_kept: int) -> int:
    """Keep the digests of all entries after the first `n_kept` beside the database; return how many are kept now.

    The file is not flushed, so it may be behind. What it has is never written over.
    """
    rows = connection.execute(
        "SELECT entry, digest FROM audit WHERE entry > ? AND digest IS NOT NULL ORDER BY entry", (n_kept,)
    ).fetchall()
    if not rows:
        return n_kept
    descriptor = os.open(folder / DIGESTS, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o640)
    try:
        for entry, digest in rows:
            os.pwrite(descriptor, f"{digest}\n".encode(), (entry - 1) * LINE_BYTES)
    finally:
        os.close(descriptor)
    return int(rows[-1][0])


def has_kept(connection: sqlite3.Connection, kept: Sequence[str]) -> bool:
    """True when the audit has the newest of these entries, each with its digest."""
    first = max(len(kept) - N_NEWEST, 0)
    newest = "SELECT entry, digest FROM audit WHERE entry BETWEEN ? AND ?"
    found = dict(connection.execute(newest, (first + 1, len(kept)))) if kept else {}
    return all(digest in ("", found.get(entry)) for entry, digest in enumerate(kept[first:], first + 1))


def check_chain(connection: sqlite3.Connection, known: Sequence[str] = ()) -> Chain:
    """Verify the chain of digests, also against those `known` from elsewhere, in the same order."""
    n_entries, digest, broken_at = 0, "", None
    for *row, kept in _rows(connection, None, 0, -1):
        n_entries += 1
        digest = next_digest(digest, tuple(row))
        is_known = n_entries > len(known) or known[n_entries - 1] in ("", kept or digest)
        is_next = row[0] == n_entries and kept in (None, digest) and is_known
        if not is_next and broken_at is None:
            broken_at = n_entries
        digest = kept or digest
    if n_entries < len(known) and broken_at is None:
        broken_at = n_entries + 1
    return Chain(n_entries, digest, broken_at)


def redact_configurations(connection: sqlite3.Connection) -> None:
    """Redact what entries about the configuration say, within the transaction of a migration, and note that.

    Digests from there on are computed anew, but for those that did not fit before: what was edited stays broken.
    """
    connection.execute("PRAGMA secure_delete = ON")  # what is replaced does not stay in the file
    connection.execute("DROP TRIGGER IF EXISTS audit_is_not_edited")
    was = now = ""  # the digest before, in the old chain and in the new one
    last, changed = 0, []
    while rows := list(_rows(connection, None, last, PAGE)):
        for *columns, kept in rows:
            old, new = tuple(columns), _redacted(columns)
            old_digest, new_digest = next_digest(was, old), next_digest(now, new)
            new_kept = new_digest if kept == old_digest else kept
            if (new, new_kept) != (old, kept):
                connection.execute(
                    "UPDATE audit SET before = ?, after = ?, digest = ? WHERE entry = ?",
                    (*new[-2:], new_kept, old[0]),
                )
            if new != old:
                changed.append(old[0])
            was, now = kept or old_digest, new_kept or new_digest
        last = rows[-1][0]
    connection.execute(
        "CREATE TRIGGER audit_is_not_edited BEFORE UPDATE ON audit"
        " BEGIN SELECT RAISE(ABORT, 'the audit is never edited'); END"
    )
    if changed:
        facts = {"digest": now, "entries": changed}
        note(connection, "migration", "audit redacted", "URLs", before={"digest": was}, after=facts)


def entries(connection: sqlite3.Connection, subject: str | None, after: int, limit: int) -> list[AuditEntry]:
    """Return up to `limit` entries after a number, of one subject or of all, in their order."""
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in _rows(connection, subject, after, limit)]
    return [
        AuditEntry(**row | {name: row[name] and json.loads(row[name]) for name in ("before", "after")})
        for row in rows
    ]


def csv_page(
    connection: sqlite3.Connection, subject: str | None, after: int, limit: int
) -> tuple[bytes, int | None]:
    """Return up to `limit` entries as lines of CSV (RFC 4180), and the number of the last; None if there is no more."""
    rows = list(_rows(connection, subject, after, limit))
    head = [COLUMNS] if after == 0 else []
    return csv_text([*head, *rows]).encode(), rows[-1][0] if len(rows) == limit else None


def _rows(
    connection: sqlite3.Connection, subject: str | None, after: int, limit: int
) -> Iterator[tuple[Any, ...]]:
    condition, given = ("", ()) if subject is None else (" AND subject = ?", (subject,))
    return connection.execute(
        f"SELECT {', '.join(COLUMNS)} FROM audit WHERE entry > ?{condition} ORDER BY entry LIMIT ?",  # noqa: S608
        (after, *given, limit),
    )


def _text(facts: Mapping[str, Any] | None) -> str | None:
    return None if facts is None else json.dumps(facts)


def _redacted(columns: list[Any]) -> tuple[Any, ...]:
    *others, action, subject, before, after = columns
    if action == CONFIGURATION:
        before, after = (each and _text(redacted(json.loads(each))) for each in (before, after))
    return (*others, action, subject, before, after)
