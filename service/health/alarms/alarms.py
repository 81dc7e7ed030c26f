"""The alarms of the daemon: the states in memory, each change in the store and among the events."""

import json
import logging
import sqlite3
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta

from pydantic import TypeAdapter, ValidationError

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.status import HealthCheck
from service.health.alarms.alarm import Alarm, AlarmState
from service.health.alarms.machine import MAX_SHELVED_S, AlarmMachine, Change
from service.health.alarms.rules import load_rules
from service.store import Store, audit
from service.store.event_log import EventLog
from service.store.events import NewEvent

log = logging.getLogger(__name__)

ALARM = TypeAdapter(Alarm)
WRITTEN_S = 5.0
"""Longest wait of a request for the disk; what was asked for holds all the same, and is written later."""


async def open_alarms(store: Store, log: EventLog) -> "Alarms":
    """Return the alarms, as an earlier run of the daemon has left them."""
    left, next_id = await store.read(unended)
    machine = AlarmMachine(load_rules(), left, next_id=next_id)
    now, now_s = datetime.now(UTC), time.monotonic()
    for alarm in left:
        if alarm.shelved_until is not None:
            remaining = datetime.fromisoformat(alarm.shelved_until) - now
            machine.resume_shelf(alarm.check, now_s + min(remaining.total_seconds(), MAX_SHELVED_S))
    return Alarms(machine, log)


class Alarms:
    """Alarms of the daemon; made by `open_alarms`. Call it on the event loop."""

    def __init__(self, machine: AlarmMachine, log: EventLog) -> None:
        self._machine = machine
        self._log = log
        self._checks: Mapping[str, HealthCheck] = {}
        self.rules = load_rules()

    def update(self, checks: Mapping[str, HealthCheck]) -> None:
        """Update the alarms by the present checks of health; to be called often."""
        self._checks = checks
        for change in self._machine.update(checks, time.monotonic(), utc_now()):
            self._note(change)

    def within(self, *states: AlarmState) -> list[Alarm]:
        """Return the alarms in these states that have not ended, the most urgent first."""
        return [alarm for alarm in self._machine.alarms if alarm.state in states]

    async def acknowledge(self, number: int, who: str) -> Alarm | None:
        """Acknowledge an alarm and return it, None if it has ended; raise `AlarmConflictError` as the machine does."""
        before = self._machine.find(number)
        change = self._machine.acknowledge(number, who, utc_now())
        return await self._asked(before, [] if change is None else [change], who, "alarm acknowledged")

    async def shelve(self, number: int, minutes: float, who: str, reason: str) -> Alarm | None:
        """Put an alarm aside for some minutes, and return it; None if there is none that has not ended."""
        before, shelf = self._machine.find(number), timedelta(minutes=minutes)
        ends_s = time.monotonic() + min(shelf.total_seconds(), MAX_SHELVED_S)
        until = rfc3339(datetime.now(UTC) + shelf)
        change = self._machine.shelve(number, who, reason, ends_s=ends_s, until=until, at=utc_now())
        return await self._asked(before, [] if change is None else [change], who, "alarm shelved")

    async def unshelve(self, number: int, who: str) -> Alarm | None:
        """Unshelve an alarm and return it, None if it has ended; raise `AlarmConflictError` if it is not shelved."""
        before = self._machine.unshelve(number, time.monotonic())
        changes = self._machine.update(self._checks, time.monotonic(), utc_now())
        return await self._asked(before, changes, who, "alarm unshelved")

    async def _asked(
        self, before: Alarm | None, changes: Iterable[Change], who: str, action: str
    ) -> Alarm | None:
        """Note changes, that of an alarm with its author, and return the alarm as it is then."""
        after = before
        for change in changes:
            if before is not None and change.alarm.id == before.id:
                after = change.alarm
                self._note(change, before, who, action)
            else:
                self._note(change)
        await self._log.written(WRITTEN_S)
        return after

    def _note(self, change: Change, before: Alarm | None = None, who: str = "", action: str = "") -> None:
        alarm = change.alarm

        def write(connection: sqlite3.Connection) -> None:
            keep(connection, alarm)
            if before is not None:
                audit.note(connection, who, action, alarm.check, before=asdict(before), after=asdict(alarm))

        facts = {name: value for name, value in asdict(alarm).items() if name not in ("check", "changed_at")}
        event = change.event and NewEvent(type=change.event, subject=alarm.check, data=facts)
        self._log.note(*[event] if event else [], write=write)


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
