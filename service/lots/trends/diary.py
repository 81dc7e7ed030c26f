"""The crusher's diary: what the plant has set or changed, and when; never edited."""

import sqlite3
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import ServiceError
from service.store import audit
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import transaction

CLOCKS_DIFFER_S = 60.0
"""An entry may be so much in the future: who writes it has another clock."""


class DiaryKind(StrEnum):
    """What was done to the crusher."""

    GAP = "gap"
    """Its closed side setting; the value is in mm."""
    LINER = "liner"
    """Its liners were changed or turned."""
    FEED = "feed"
    """The feed of the crusher was changed; the value is in t/h."""
    OTHER = "other"


class FutureEntryError(ServiceError):
    """The entry is of a time that has not come."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewEntry:
    """An entry that has no number yet."""

    kind: DiaryKind
    text: str = ""
    value: float | None = None
    at: str | None = None  # RFC 3339 UTC; now when None


@dataclass(frozen=True, slots=True, kw_only=True)
class DiaryEntry:
    """An entry of the diary."""

    entry: int
    at: str
    kind: DiaryKind
    text: str
    value: float | None
    who: str
    noted_at: str


def note_entry(connection: sqlite3.Connection, new: NewEntry, who: str) -> DiaryEntry:
    """Enter something into the diary, with an event and an entry of the audit.

    Raises
    ------
    FutureEntryError
        It is of a time that has not come.
    """
    now = utc_now()
    at = new.at or now
    if at > rfc3339(datetime.now(UTC) + timedelta(seconds=CLOCKS_DIFFER_S)):
        raise FutureEntryError(f"at: {at} is in the future, it is {now}")
    with transaction(connection):
        (number,) = connection.execute("SELECT coalesce(max(entry), 0) + 1 FROM diary").fetchone()
        noted = DiaryEntry(
            entry=number, at=at, kind=new.kind, text=new.text, value=new.value, who=who, noted_at=now
        )
        connection.execute(
            "INSERT INTO diary VALUES (:entry, :at, :kind, :text, :value, :who, :noted_at)", asdict(noted)
        )
        audit.note(connection, who, "diary noted", str(number), after=asdict(noted))
        note_event(connection, NewEvent(type=EventType.DIARY_NOTED, subject=str(number), data=asdict(noted)))
    return noted


def entries(
    connection: sqlite3.Connection, since: str | None, until: str | None, limit: int
) -> list[DiaryEntry]:
    """Return up to `limit` entries of a time, the newest first."""
    rows = connection.execute(
        "SELECT entry, at, kind, text, value, who, noted_at FROM diary"
        " WHERE at >= coalesce(?, '') AND at < coalesce(?, '9') ORDER BY at DESC, entry DESC LIMIT ?",
        (since, until, limit),
    )
    return [
        DiaryEntry(
            entry=number, at=at, kind=DiaryKind(kind), text=text, value=value, who=who, noted_at=noted_at
        )
        for number, at, kind, text, value, who, noted_at in rows
    ]
