"""Who changed what, in the order of the changes; written in the transaction of the change, and never edited."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.files.times import utc_now


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEntry:
    """One change."""

    entry: int
    at: str
    who: str
    action: str
    subject: str
    before: Mapping[str, Any] | None
    after: Mapping[str, Any] | None


def note(
    connection: sqlite3.Connection,
    who: str,
    action: str,
    subject: str,
    *,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
) -> None:
    """Note a change within the transaction that makes it."""
    texts = [None if each is None else json.dumps(each) for each in (before, after)]
    connection.execute(
        "INSERT INTO audit (at, who, action, subject, before, after) VALUES (?, ?, ?, ?, ?, ?)",
        (utc_now(), who, action, subject, *texts),
    )


def entries(connection: sqlite3.Connection, subject: str | None, after: int, limit: int) -> list[AuditEntry]:
    """Return up to `limit` entries after a number, of one subject or of all, in their order."""
    rows = connection.execute(
        "SELECT entry, at, who, action, subject, before, after FROM audit"
        " WHERE entry > ? AND (? IS NULL OR subject = ?) ORDER BY entry LIMIT ?",
        (after, subject, subject, limit),
    )
    return [
        AuditEntry(
            entry=entry,
            at=at,
            who=who,
            action=action,
            subject=about,
            before=before and json.loads(before),
            after=changed and json.loads(changed),
        )
        for entry, at, who, action, about, before, changed in rows
    ]
