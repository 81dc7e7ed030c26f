"""The table of alarms: those of an earlier run, and the history."""

import json
import logging
import sqlite3
from dataclasses import asdict

from pydantic import TypeAdapter, ValidationError

from service.health.alarms.alarm import Alarm

log = logging.getLogger(__name__)

ALARM = TypeAdapter(Alarm)


def keep(connection: sqlite3.Connection, alarm: Alarm) -> None:
    """Write an alarm as it is now, within a transaction."""
    # an end that was given up while the store was held
    connection.execute(
        "UPDATE alarms SET ended_at = ? WHERE subject = ? AND alarm < ? AND ended_at IS NULL",
        (alarm.changed_at, alarm.check, alarm.id),
    )
    connection.execute(
        "INSERT INTO alarms (alarm, subject, state, ended_at, document) VALUES (?, ?, ?, ?, ?) ON CONFLICT (alarm)"
        " DO UPDATE SET state = excluded.state, ended_at = excluded.ended_at, document = excluded.document",
        (alarm.id, alarm.check, alarm.state, alarm.ended_at, json.dumps(asdict(alarm))),
    )


def unended(connection: sqlite3.Connection) -> tuple[list[Alarm], int]:
    """Return the alarms that have not ended, and the number of the next one; those that cannot be read are left out."""
    (newest,) = connection.execute("SELECT coalesce(max(alarm), 0) FROM alarms").fetchone()
    alarms = []
    for number, document in connection.execute(
        "SELECT alarm, document FROM alarms WHERE ended_at IS NULL ORDER BY alarm"
    ):
        try:
            alarms.append(ALARM.validate_json(document))
        except ValidationError as err:  # `keep` ends it when its check is an alarm again
            log.error("an alarm cannot be read alarm=%d: %s", number, err)
    return alarms, newest + 1


def history(connection: sqlite3.Connection, check: str | None, before: int, limit: int) -> list[Alarm]:
    """Return up to `limit` alarms before a number, of one check or of all, newest first."""
    rows = connection.execute(
        "SELECT document FROM alarms WHERE alarm < ? AND (? IS NULL OR subject = ?) ORDER BY alarm DESC LIMIT ?",
        (before, check, check, limit),
    ).fetchall()
    return [ALARM.validate_json(document) for (document,) in rows]
