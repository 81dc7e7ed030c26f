"""One alarm, from its first rise to its end."""

from enum import StrEnum

from service.base.messages import CodedFinding
from service.base.schema import OptionalTime, Time, served
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


@served
class Alarm:
    """An alarm, from its first rise to its end."""

    id: int
    """Number of the alarm, in the order in which they were raised."""
    check: str
    """The check of `/health` that does not pass, such as `gate` or `camera:c01`."""
    state: AlarmState
    """In the words of ISA-18.2; returned: its cause is gone, and it was not acknowledged."""
    priority: Priority
    """The highest since it was raised."""
    detail: str | None
    """What the check says."""
    findings: tuple[CodedFinding, ...] = ()
    """The same, as codes with their parameters."""
    raised_at: Time
    """When it was first raised, RFC 3339 UTC."""
    changed_at: Time
    """When its state or priority last changed."""
    occurrences: int = 1
    """Times that its cause occurred until it was acknowledged, at least 1."""
    cleared_at: OptionalTime = None
    """When its cause was last gone."""
    acknowledged_at: OptionalTime = None
    """When it was acknowledged; null while it is not."""
    acknowledged_by: str | None = None
    """Name of the key that acknowledged it."""
    shelved_until: OptionalTime = None
    """When it comes back; null while it is not shelved."""
    shelved_by: str | None = None
    """Name of the key that put it aside."""
    shelf_reason: str | None = None
    """Why it was put aside."""
    ended_at: OptionalTime = None
    """When it ended; null while it has not."""
