"""Look at the daemon's health every second: what has changed becomes alarms and events, whether anyone asks or not."""

import asyncio
import logging
import time
from collections.abc import Callable

from service.base.status import AcquisitionState, Health, Ne107
from service.calibration.verifications import Verification
from service.health.alarms.alarms import Alarms
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent

log = logging.getLogger(__name__)

TICK_S = 1.0
LASTING_S = 3.0
"""Time for which the device must have another NE 107 word before that is an event."""


class Alarming:
    """Evaluates the alarms: `run` is its task."""

    def __init__(self, alarms: Alarms, events: EventLog) -> None:
        self.alarms = alarms
        self.events = events
        self._told: Ne107 | None = None
        self._seen: Ne107 | None = None
        self._seen_since_s = 0.0

    async def run(self, health: Callable[[], Health]) -> None:
        """Look at the health again and again."""
        while True:
            try:
                self.look(health(), time.monotonic())
            except OSError as err:  # of a disk, which must not end the daemon
                log.error("health cannot be assessed: %s", err)
            await asyncio.sleep(TICK_S)

    def look(self, health: Health, now_s: float) -> None:
        """Note the present health; another word is an event once it has lasted."""
        self.alarms.update(health.checks)
        if health.ne107 is not self._seen:
            self._seen, self._seen_since_s = health.ne107, now_s
        has_lasted = self._told is None or now_s - self._seen_since_s >= LASTING_S
        if self._seen is not self._told and has_lasted:
            before, self._told = self._told, health.ne107
            data = {"ne107": health.ne107, "before": before, "reasons": health.reasons}
            self.events.note(NewEvent(type=EventType.HEALTH_CHANGED, subject="device", data=data))


def acquisition_changed(state: AcquisitionState, trouble: str | None) -> NewEvent:
    """Return the event of another state of the rig."""
    data = {"state": state, "trouble": trouble}
    return NewEvent(type=EventType.ACQUISITION_CHANGED, subject="acquisition", data=data)


def verification_ended(verification: Verification) -> NewEvent:
    """Return the event of a verification with its verdict, or cancelled, or declared void."""
    summary = verification.summary
    data = {
        "outcome": verification.state,
        "calibration_id": verification.calibration_id,
        "diameter_mm": verification.diameter_mm,
        "error_mm": None if summary is None else summary.error_mm,
        "problems": verification.problems,
    }
    return NewEvent(type=EventType.VERIFICATION_ENDED, subject=verification.id, data=data)
