"""Events: what happened beside results, numbered without a gap, in the transaction of what changed."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from http import HTTPStatus
from typing import Any

from drivers.files.times import utc_now
from service.base.errors import ProblemError, ProblemKind
from service.base.schema import Time, served
from service.store.schema import rows_by_name

NEW_HISTORY_STEP = 1_000_000
"""By which numbers go on in a history that begins anew: more events than a backup can lack."""


class EventType(StrEnum):
    """What happened."""

    LOT_OPENED = "lot.opened"
    LOT_CLOSED = "lot.closed"
    LOT_COMPLETED = "lot.completed"
    """All stones of this closed lot have outcomes: this revision's figures are final, and its report is issued."""
    LOT_DOES_NOT_CONFORM = "lot.does_not_conform"
    """A lot was completed, and its product's specification is not met."""
    LOT_VERDICT_REACHED = "lot.verdict_reached"
    """The stones of the open lot allow a verdict, or another one than before; it is final with `lot.completed`."""
    LOT_VOIDED = "lot.voided"
    LOT_ASSIGNED = "lot.assigned"
    """Stones that were in no lot are in this one now."""
    LOT_REVISED = "lot.revised"
    """A stone of this closed lot was measured again."""
    ALARM_RAISED = "alarm.raised"
    """It needs an operator: it is new, has come back, has become worse, or is suppressed or shelved no longer."""
    ALARM_CLEARED = "alarm.cleared"
    """Its cause is gone, or it is suppressed under another alarm."""
    ALARM_ACKNOWLEDGED = "alarm.acknowledged"
    ALARM_SHELVED = "alarm.shelved"
    CALIBRATION_ACTIVATED = "calibration.activated"
    VERIFICATION_ENDED = "verification.ended"
    ACQUISITION_CHANGED = "acquisition.changed"
    HEALTH_CHANGED = "health.changed"
    """The NE 107 word of the device is another one."""
    PRODUCT_DRIFTING = "product.drifting"
    """The product's newest lot is out of control, and the one before was not."""
    SHIFT_ENDED = "shift.ended"
    """A shift is over, and all stones that fell in it have outcomes."""
    DIARY_NOTED = "diary.noted"
    """The plant has noted what it did to the crusher."""


@served
class NewEvent:
    """An event that has no number yet."""

    type: EventType
    """What happened; later versions have more types."""
    subject: str
    """To what: a lot, the check of an alarm, a calibration, a verification."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """More of it, by type."""
    at: Time = field(default_factory=utc_now)
    """When it happened, RFC 3339 UTC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryPage:
    """Consecutive events or results, and the first and last number of all at the same moment."""

    first_seq: int  # oldest one kept; last_seq + 1 when there is none
    last_seq: int  # 0 before the first
    items: list[dict[str, Any]]


class CursorError(ProblemError):
    """A feed does not reach that far, or no longer has what follows; names its first and its last number."""

    kinds = (
        ProblemKind("cursor-ahead", HTTPStatus.CONFLICT, "The cursor is ahead of the history"),
        ProblemKind("cursor-expired", HTTPStatus.GONE, "The cursor is older than the oldest result kept"),
    )

    def __init__(self, problem: str, after: int, first_seq: int, last_seq: int) -> None:
        kind = "cursor-ahead" if after > last_seq else "cursor-expired"
        super().__init__(problem, kind, first_seq=first_seq, last_seq=last_seq)


def note_event(connection: sqlite3.Connection, event: NewEvent) -> int:
    """Number an event within the transaction that makes it true, and return the number."""
    (number,) = connection.execute(
        "UPDATE store SET last_event = last_event + 1 RETURNING last_event"
    ).fetchone()
    connection.execute(
        "INSERT INTO events (seq, at, type, subject, data) VALUES (?, ?, ?, ?, ?)",
        (number, event.at, event.type, event.subject, json.dumps(event.data, allow_nan=False)),
    )
    return int(number)


def event_ends(connection: sqlite3.Connection) -> tuple[int, int]:
    """Return the number of the oldest event that is kept, that of the next one if there is none, and of the newest."""
    last_seq, first_seq = connection.execute(
        "SELECT last_event, coalesce((SELECT min(seq) FROM events), last_event + 1) FROM store"
    ).fetchone()
    return first_seq, last_seq


def events_after(
    connection: sqlite3.Connection, after: int, limit: int, types: Sequence[EventType] | None = None
) -> HistoryPage:
    """Return up to `limit` events after a number, of some types or of all, in order."""
    first_seq, last_seq = event_ends(connection)
    rows = connection.execute(
        "SELECT seq, at, type, subject, data FROM events WHERE seq > ?1"
        " AND (?2 IS NULL OR type IN (SELECT value FROM json_each(?2))) ORDER BY seq LIMIT ?3",
        (after, types and json.dumps(types), limit),
    )
    items = [row | {"data": json.loads(row["data"])} for row in rows_by_name(rows)]
    return HistoryPage(first_seq=first_seq, last_seq=last_seq, items=items)
