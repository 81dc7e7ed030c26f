"""Alarms as conditions (OPC 10000-9): each check of the daemon that can raise one is an AlarmConditionType."""

import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from asyncua import ua
from asyncua.common.event_objects import AlarmCondition

from service.bridge.opcua.nodes import ROOT
from service.bridge.opcua.space import node_id
from service.bridge.plant_state import PlantAlarm, PlantState

SEVERITIES = {"urgent": 900, "high": 700, "medium": 500, "low": 300}
"""Priority of the daemon -> severity of OPC UA, 1 to 1000."""
MAX_EVENT_IDS = 20


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition as it was last sent: its event, and the alarm that it is of."""

    event: AlarmCondition
    alarm: PlantAlarm
    is_known: bool
    event_ids: tuple[bytes, ...]
    """Ids of the newest events of this alarm: it can be acknowledged by each."""

    def tells(self, alarm: PlantAlarm) -> bool:
        """True when its event tells all of an alarm but for its text, which may change with every look."""
        return self.is_known and replace(alarm, detail=self.alarm.detail) == self.alarm


def condition_id(alarm: PlantAlarm) -> ua.NodeId:
    """Return the identifier of an alarm's condition, which is that of its check."""
    return node_id(f"{ROOT}.Alarms.{alarm.check}")


class PlantConditions:
    """The conditions that are retained."""

    def __init__(self) -> None:
        self._by_check: dict[str, Condition] = {}

    def follow(self, state: PlantState) -> Iterator[AlarmCondition]:
        """Yield an event for each changed condition; all are of bad quality while the daemon does not answer."""
        now = {alarm.check: alarm for alarm in state.alarms}
        for check, known in list(self._by_check.items()):
            if not state.daemon_answers:
                if known.is_known:
                    yield self._keep(known.alarm, is_known=False)
            elif check not in now:
                del self._by_check[check]
                yield condition_event(known.alarm, is_known=True, is_ended=True)
        for check, alarm in now.items():
            if (before := self._by_check.get(check)) is None or not before.tells(alarm):
                yield self._keep(alarm, is_known=True)

    def retained(self) -> list[AlarmCondition]:
        """Return the last events of all that need an operator, for ConditionRefresh."""
        return [each.event for each in self._by_check.values()]

    def alarm_of(self, condition: ua.NodeId, event_id: bytes) -> PlantAlarm | None:
        """Return the alarm of a condition, if this is the id of one of its newest events."""
        for each in self._by_check.values():
            if event_id in each.event_ids and condition_id(each.alarm) == condition:
                return each.alarm
        return None

    def _keep(self, alarm: PlantAlarm, *, is_known: bool) -> AlarmCondition:
        event = condition_event(alarm, is_known=is_known, is_ended=False)
        before = self._by_check.get(alarm.check)
        earlier = before.event_ids if before is not None and before.alarm.id == alarm.id else ()
        ids = (*earlier, event.EventId)[-MAX_EVENT_IDS:]
        self._by_check[alarm.check] = Condition(event, alarm, is_known, ids)
        return event


def condition_event(alarm: PlantAlarm, *, is_known: bool, is_ended: bool) -> AlarmCondition:
    """Return the event that tells how a condition is now."""
    is_active = not is_ended and alarm.state != "returned"
    is_acked = is_ended or alarm.state == "acknowledged"
    text = alarm.detail or alarm.check
    event = AlarmCondition(
        message=f"{text}: ended, shelved or suppressed" if is_ended else text,
        severity=SEVERITIES.get(alarm.priority, SEVERITIES["urgent"]),
    )
    event.EventId = uuid.uuid4().bytes
    event.SourceNode, event.SourceName = node_id(ROOT), ROOT
    event.add_property("NodeId", condition_id(alarm), ua.VariantType.NodeId)
    event.ConditionClassId = ua.NodeId(ua.ObjectIds.SystemConditionClassType)
    event.ConditionClassName = ua.LocalizedText("SystemConditionClassType")
    event.ConditionName = alarm.check
    event.BranchId = ua.NodeId()
    event.Retain = not is_ended
    event.Quality = ua.StatusCode(ua.StatusCodes.Good if is_known else ua.StatusCodes.BadNoCommunication)
    event.LastSeverity = event.Severity
    event.Comment = ua.LocalizedText(f"{alarm.cause} {alarm.action}".strip())
    event.ClientUserId = alarm.acknowledged_by or ""
    event.SuppressedOrShelved = False
    event.InputNode = ua.NodeId()
    states: Mapping[str, tuple[bool, str]] = {
        "EnabledState": (True, "Enabled"),
        "ActiveState": (is_active, "Active" if is_active else "Inactive"),
        "AckedState": (is_acked, "Acknowledged" if is_acked else "Unacknowledged"),
    }
    for name, (is_true, word) in states.items():
        setattr(event, name, ua.LocalizedText(word))
        setattr(event, f"{name}/Id", is_true)
    return event
