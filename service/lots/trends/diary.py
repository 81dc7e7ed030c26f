"""The crusher's diary: what the plant has set or changed, and when; never edited."""

import sqlite3
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import InvalidRequestError
from service.base.schema import TIME, GivenTime, Time, request_body, served
from service.store import audit
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import rows_by_name

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


class FutureEntryError(InvalidRequestError):
    """The entry is of a time that has not come."""


@request_body
class DiaryRequest:
    """Something that was done to the crusher."""

    kind: DiaryKind
    """To the `gap` (closed side setting), the `liner`, the `feed`, or anything `other`."""
    text: Annotated[str, Field(max_length=500)] = ""
    """Whatever is to be said of it."""
    value: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Setting of a `gap`, mm; rate of a `feed`, t/h."""
    at: Annotated[GivenTime | None, Field(json_schema_extra=TIME)] = None
    """When it was done, RFC 3339; now when absent, never in the future."""


@served
class DiaryEntry:
    """An entry of the crusher's diary."""

    entry: int
    """Number of the entry, in the order in which they were noted."""
    at: Time
    """When it was done, RFC 3339 UTC."""
    kind: DiaryKind
    """What was done: to the `gap` (closed side setting), the `liner`, the `feed`, or `other`."""
    text: str
    """In the words of who noted it; may be empty."""
    value: float | None
    """Setting of a `gap`, mm; rate of a `feed`, t/h; null: none given."""
    who: str
    """Who noted it: a key or this machine."""
    noted_at: Time
    """When it was noted, RFC 3339 UTC."""


def note_entry(connection: sqlite3.Connection, new: DiaryRequest, who: str) -> DiaryEntry:
    """Enter something into the diary, with an event and an entry of the audit; raise `FutureEntryError`."""
    now = utc_now()
    at = new.at or now
    if at > rfc3339(datetime.now(UTC) + timedelta(seconds=CLOCKS_DIFFER_S)):
        raise FutureEntryError(f"body.at: {at} is in the future, it is {now}")
    (number,) = connection.execute("SELECT coalesce(max(entry), 0) + 1 FROM diary").fetchone()
    noted = DiaryEntry(**asdict(new) | {"entry": number, "at": at, "who": who, "noted_at": now})
    connection.execute(
        "INSERT INTO diary (entry, at, kind, text, value, who, noted_at)"
        " VALUES (:entry, :at, :kind, :text, :value, :who, :noted_at)",
        asdict(noted),
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
    return [DiaryEntry(**row | {"kind": DiaryKind(row["kind"])}) for row in rows_by_name(rows)]
