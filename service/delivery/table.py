"""The tables of webhooks: progress of each endpoint, its newest deliveries, and its events that are due."""

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from http import HTTPStatus
from typing import Any

from pydantic import TypeAdapter

from service.base.errors import ProblemError, ProblemKind
from service.base.schema import ANSWER, Time
from service.delivery.progress import EndpointProgress, enabled, replayed
from service.store import audit
from service.store.events import EventType, event_ends

PROGRESS = TypeAdapter(EndpointProgress)
MAX_DELIVERIES = 500
"""Newest deliveries of each endpoint that are kept."""


class EventCursorError(ProblemError):
    """The events do not reach that far, or no longer have what follows; names their first and last number."""

    kinds = (
        ProblemKind("cursor-ahead", HTTPStatus.CONFLICT, "The cursor is ahead of the history"),
        ProblemKind("cursor-expired", HTTPStatus.GONE, "The cursor is older than the oldest result kept"),
    )

    def __init__(self, after: int, first_seq: int, last_seq: int) -> None:
        super().__init__(
            f"events {first_seq} to {last_seq} are kept: nothing can be told again after {after}",
            "cursor-ahead" if after > last_seq else "cursor-expired",
            first_seq=first_seq,
            last_seq=last_seq,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One attempt to post to an endpoint."""

    __pydantic_config__ = ANSWER

    at: Time
    """When it was begun, RFC 3339 UTC."""
    webhook_id: str
    """The same on every attempt to post an event."""
    type: str
    """Type of the event, or `webhook.test`."""
    event: int | None
    """`seq` of the event; null for a test."""
    attempt: int
    """1: the first."""
    status: int | None
    """HTTP status of the answer; null if there was none."""
    problem: str | None
    """Why the message was not taken; null if it was."""
    duration_ms: int
    """From its begin to the answer, ms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Due:
    """The next event of an endpoint."""

    event: Mapping[str, Any] | None  # None: nothing up to `last_seq`
    first_seq: int  # oldest event that is kept
    last_seq: int


def begin(connection: sqlite3.Connection, names: Iterable[str]) -> None:
    """Begin new endpoints at the events from now on."""
    (last,) = connection.execute("SELECT last_event FROM store").fetchone()
    first = json.dumps(asdict(EndpointProgress(after=last)))
    connection.executemany(
        "INSERT OR IGNORE INTO webhooks (name, progress) VALUES (?, ?)", [(name, first) for name in names]
    )


def progress_of(connection: sqlite3.Connection, name: str) -> EndpointProgress:
    """Return the progress of an endpoint, one that `begin` knows."""
    (document,) = connection.execute("SELECT progress FROM webhooks WHERE name = ?", (name,)).fetchone()
    return PROGRESS.validate_json(document)


def next_due(connection: sqlite3.Connection, after: int, types: Sequence[EventType]) -> Due:
    """Return the first event of these types after a number."""
    first_seq, last_seq = event_ends(connection)
    row = connection.execute(
        "SELECT seq, at, type, subject, data FROM events WHERE seq > ?"  # noqa: S608 - question marks
        f" AND type IN ({_marks(types)}) ORDER BY seq LIMIT 1",
        (after, *types),
    ).fetchone()
    if row is None:
        return Due(event=None, first_seq=first_seq, last_seq=last_seq)
    number, at, kind, subject, data = row
    event = {"seq": number, "at": at, "type": kind, "subject": subject, "data": json.loads(data)}
    return Due(event=event, first_seq=first_seq, last_seq=last_seq)


def n_due(connection: sqlite3.Connection, after: int, types: Sequence[EventType]) -> int:
    """Count the events of these types after a number."""
    (number,) = connection.execute(
        f"SELECT count(*) FROM events WHERE seq > ? AND type IN ({_marks(types)})",  # noqa: S608 - question marks
        (after, *types),
    ).fetchone()
    return int(number)


def note(
    connection: sqlite3.Connection,
    name: str,
    delivery: Attempt,
    before: EndpointProgress,
    after: EndpointProgress,
) -> EndpointProgress:
    """Note an attempt and what follows from it; return the endpoint's progress.

    A request since `before`, as to enable it, takes precedence: then only the attempt is noted.
    """
    _add(connection, name, delivery)
    now = progress_of(connection, name)
    if now != before:
        return now
    _keep(connection, name, after)
    return after


def note_trial(connection: sqlite3.Connection, name: str, delivery: Attempt, who: str) -> None:
    """Note the test of an endpoint, and its requester."""
    _add(connection, name, delivery)
    audit.note(connection, who, "webhook tested", name, after=asdict(delivery))


def deliveries(connection: sqlite3.Connection, name: str, limit: int) -> list[Attempt]:
    """Return the newest attempts of an endpoint, newest first."""
    rows = connection.execute(
        "SELECT document FROM webhook_deliveries WHERE name = ? ORDER BY delivery DESC LIMIT ?", (name, limit)
    )
    return [Attempt(**json.loads(document)) for (document,) in rows]


def enable(connection: sqlite3.Connection, name: str, who: str) -> EndpointProgress:
    """Try an endpoint again at once, whether it was disabled or waits."""
    before = progress_of(connection, name)
    return _change(connection, name, who, "webhook enabled", before, enabled(before))


def replay(connection: sqlite3.Connection, name: str, after: int, who: str) -> EndpointProgress:
    """Post all events after a number to an endpoint again; raise `EventCursorError` if they are not there."""
    first_seq, last_seq = event_ends(connection)
    if not first_seq - 1 <= after <= last_seq:
        raise EventCursorError(after, first_seq, last_seq)
    before = progress_of(connection, name)
    return _change(connection, name, who, "webhook replayed", before, replayed(before, after))


def _add(connection: sqlite3.Connection, name: str, delivery: Attempt) -> None:
    connection.execute(
        "INSERT INTO webhook_deliveries (name, document) VALUES (?, ?)", (name, json.dumps(asdict(delivery)))
    )
    connection.execute(
        "DELETE FROM webhook_deliveries WHERE name = ?1 AND delivery <= (SELECT delivery FROM webhook_deliveries"
        " WHERE name = ?1 ORDER BY delivery DESC LIMIT 1 OFFSET ?2)",
        (name, MAX_DELIVERIES),
    )


def _change(
    connection: sqlite3.Connection,
    name: str,
    who: str,
    action: str,
    before: EndpointProgress,
    after: EndpointProgress,
) -> EndpointProgress:
    _keep(connection, name, after)
    audit.note(connection, who, action, name, before=asdict(before), after=asdict(after))
    return after


def _keep(connection: sqlite3.Connection, name: str, progress: EndpointProgress) -> None:
    connection.execute(
        "UPDATE webhooks SET progress = ? WHERE name = ?", (json.dumps(asdict(progress)), name)
    )


def _marks(values: Sequence[object]) -> str:
    return ", ".join("?" * len(values))
