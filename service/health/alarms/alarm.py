"""One alarm, from its first rise to its end."""

from dataclasses import dataclass
from enum import StrEnum

from service.health.alarms.rules import Priority


class AlarmState(StrEnum):
    """State of an alarm, in the words of ISA-18.2."""

    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"
    """Its cause is gone, and it was not acknowledged: an operator should know of it."""
    SHELVED = "shelved"
    """An operator has put it aside for a time."""
    SUPPRESSED = "suppressed"
    """Another alarm is its cause."""
    NORMAL = "normal"
    """It has ended."""


ACTIVE = (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED)
ANNOUNCED = (*ACTIVE, AlarmState.RETURNED)
"""States in which people see it in the list."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """An alarm; times are RFC 3339."""

    id: int
    check: str
    state: AlarmState
    priority: Priority  # the highest since it was raised
    detail: str | None
    raised_at: str
    changed_at: str
    occurrences: int = 1  # how often its cause came back
    cleared_at: str | None = None  # when its cause was gone last
    acknowledged_at: str | None = None
    acknowledged_by: str | None = None
    shelved_until: str | None = None
    shelved_by: str | None = None
    shelf_reason: str | None = None
    ended_at: str | None = None
