"""The tables of webhooks: progress of each endpoint, its newest deliveries, and its events that are due."""

import json
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import asdict

from pydantic import TypeAdapter

from service.base.schema import Time, served
from service.delivery.progress import EndpointProgress, enabled, replayed
from service.store import audit
from service.store.events import CursorError, EventType, event_ends

PROGRESS = TypeAdapter(EndpointProgress)
MAX_DELIVERIES = 500
"""Newest deliveries of each endpoint that are kept."""


@served
class Attempt:
    """One attempt to post to an endpoint."""

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


def begin(connection: sqlite3.Connection, names: Iterable[str]) -> None:
    """Begin new endpoints at the events from now on."""
    first = _first(connection)
    connection.executemany(
        "INSERT OR IGNORE INTO webhooks (name, progress) VALUES (?, ?)", [(name, first) for name in names]
    )


def begin_anew(connection: sqlite3.Connection, name: str) -> None:
    """Begin an endpoint at the events from now on, whatever had its name before."""
    connection.execute("DELETE FROM webhook_deliveries WHERE name = ?", (name,))
    connection.execute(
        "INSERT INTO webhooks (name, progress) VALUES (?, ?) ON CONFLICT DO UPDATE SET progress = excluded.progress",
        (name, _first(connection)),
    )


def _first(connection: sqlite3.Connection) -> str:
    (last,) = connection.execute("SELECT last_event FROM store").fetchone()
    return json.dumps(asdict(EndpointProgress(after=last)))


def progress_of(connection: sqlite3.Connection, name: str) -> EndpointProgress:
    """Return the progress of an endpoint, one that `begin` knows."""
    (document,) = connection.execute("SELECT progress FROM webhooks WHERE name = ?", (name,)).fetchone()
    return PROGRESS.validate_json(document)


def n_due(connection: sqlite3.Connection, after: int, types: Sequence[EventType]) -> int:
    """Count the events of these types after a number."""
    (number,) = connection.execute(
        "SELECT count(*) FROM events WHERE seq > ? AND type IN (SELECT value FROM json_each(?))",
        (after, json.dumps(types)),
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
    if (now := progress_of(connection, name)) != before:
        return now
    keep(connection, name, after)
    return after


def note_trial(connection: sqlite3.Connection, name: str, delivery: Attempt, who: str) -> None:
    """Note the test of an endpoint, or one event sent again, and its requester."""
    _add(connection, name, delivery)
    action = "webhook tested" if delivery.event is None else "webhook event sent again"
    audit.note(connection, who, action, name, after=asdict(delivery))


def deliveries(connection: sqlite3.Connection, name: str, limit: int) -> list[Attempt]:
    """Return the newest attempts of an endpoint, newest first."""
    rows = connection.execute(
        "SELECT document FROM webhook_deliveries WHERE name = ? ORDER BY delivery DESC LIMIT ?", (name, limit)
    )
    return [Attempt(**json.loads(document)) for (document,) in rows]


def enable(connection: sqlite3.Connection, name: str, who: str) -> None:
    """Try an endpoint again at once, whether it was disabled or waits."""
    _change(connection, name, who, "webhook enabled", enabled(progress_of(connection, name)))


def replay(connection: sqlite3.Connection, name: str, after: int, who: str) -> None:
    """Post all events after a number to an endpoint again; raise `CursorError` if they are not there."""
    first_seq, last_seq = event_ends(connection)
    if not first_seq - 1 <= after <= last_seq:
        problem = f"events {first_seq} to {last_seq} are kept: nothing can be told again after {after}"
        raise CursorError(problem, after, first_seq, last_seq)
    _change(connection, name, who, "webhook replayed", replayed(progress_of(connection, name), after))


def _add(connection: sqlite3.Connection, name: str, delivery: Attempt) -> None:
    connection.execute(
        "INSERT INTO webhook_deliveries (name, document) VALUES (?, ?)", (name, json.dumps(asdict(delivery)))
    )
    connection.execute(
        "DELETE FROM webhook_deliveries WHERE name = ?1 AND delivery <= (SELECT delivery FROM webhook_deliveries"
        " WHERE name = ?1 ORDER BY delivery DESC LIMIT 1 OFFSET ?2)",
        (name, MAX_DELIVERIES),
    )


def _change(connection: sqlite3.Connection, name: str, who: str, action: str, to: EndpointProgress) -> None:
    audit.note(connection, who, action, name, before=asdict(progress_of(connection, name)), after=asdict(to))
    keep(connection, name, to)


def keep(connection: sqlite3.Connection, name: str, progress: EndpointProgress) -> None:
    """Keep the progress of an endpoint."""
    document = json.dumps(asdict(progress))
    connection.execute("UPDATE webhooks SET progress = ? WHERE name = ?", (document, name))
