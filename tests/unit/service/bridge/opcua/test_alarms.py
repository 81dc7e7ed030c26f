"""Alarms as conditions: an event for each change of state, and ids by which they are acknowledged."""

from dataclasses import replace

from asyncua import ua
from support.opcua import ARMED, GATE

from service.bridge.opcua.alarms import MAX_EVENT_IDS, PlantConditions, condition_id
from service.bridge.plant_state import PlantAlarm, PlantState

RETURNED = replace(GATE, state="returned")


def told(conditions: PlantConditions, *alarms: PlantAlarm) -> list[tuple[bool, bool, bool]]:
    """Return of each event: is it retained, active, acknowledged."""
    events = conditions.follow(replace(ARMED, alarms=alarms))
    return [(e.Retain, getattr(e, "ActiveState/Id"), getattr(e, "AckedState/Id")) for e in events]


def test_each_change_of_state_is_one_event() -> None:
    conditions = PlantConditions()
    assert told(conditions) == []
    assert told(conditions, GATE) == [(True, True, False)]
    assert told(conditions, GATE) == []
    assert told(conditions, replace(GATE, detail="closed for 5 s")) == []
    assert told(conditions, RETURNED) == [(True, False, False)]
    assert told(conditions, replace(GATE, state="acknowledged")) == [(True, True, True)]
    assert told(conditions) == [(False, False, True)]
    assert told(conditions) == []
    assert conditions.retained() == []


def test_an_alarm_is_acknowledged_by_an_id_of_its_own_events() -> None:
    conditions = PlantConditions()
    other = replace(GATE, id=18, check="disk")
    (first, _) = conditions.follow(replace(ARMED, alarms=(GATE, other)))
    assert conditions.alarm_of(condition_id(GATE), first.EventId) == GATE
    assert conditions.alarm_of(condition_id(other), first.EventId) is None
    told(conditions, RETURNED, other)
    assert conditions.alarm_of(condition_id(GATE), first.EventId) == RETURNED
    told(conditions, replace(GATE, id=19), other)  # another one, of which that event tells nothing
    assert conditions.alarm_of(condition_id(GATE), first.EventId) is None
    assert conditions.alarm_of(condition_id(GATE), b"") is None


def test_ids_are_bounded_in_number() -> None:
    conditions = PlantConditions()
    (first,) = conditions.follow(replace(ARMED, alarms=(GATE,)))
    for _ in range(MAX_EVENT_IDS):
        told(conditions, RETURNED)
        told(conditions, GATE)
    assert conditions.alarm_of(condition_id(GATE), first.EventId) is None


def test_no_alarm_ends_because_the_daemon_does_not_answer() -> None:
    conditions = PlantConditions()
    told(conditions, GATE)
    (lost,) = conditions.follow(PlantState())
    assert (lost.Retain, lost.Quality.value) == (True, ua.StatusCodes.BadNoCommunication)
    assert list(conditions.follow(PlantState())) == []
    (back,) = conditions.follow(replace(ARMED, alarms=(GATE,)))
    assert back.Quality.is_good()


def test_urgent_alarms_are_more_severe() -> None:
    severities = []
    for priority in ("urgent", "high", "medium", "low"):
        (event,) = PlantConditions().follow(replace(ARMED, alarms=(replace(GATE, priority=priority),)))
        severities.append(event.Severity)
    assert severities == sorted(severities, reverse=True)
    assert all(1 <= severity <= 1000 for severity in severities)
