"""What the daemon notes of its health by itself."""

from dataclasses import replace

from support.rest import GOOD_HEALTH, SICK_HEALTH

from service.base.status import CheckStatus, HealthCheck
from service.daemon.alarming import LASTING_S, Alarming
from service.health.alarms.alarms import open_alarms
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import events_after


async def test_another_word_is_an_event_once_it_has_lasted(store: Store) -> None:
    log = EventLog(store)
    alarming = Alarming(await open_alarms(store, log), log)
    for now_s in range(100):  # it flickers, then it is sick
        is_sick = now_s > 90 or (now_s % 3 == 2)
        alarming.look(SICK_HEALTH if is_sick else GOOD_HEALTH, float(now_s) * LASTING_S / 3)
    await log.written()
    items = (await store.read(events_after, 0, 100)).items
    assert [(item["type"], item["data"]["before"], item["data"]["ne107"]) for item in items] == [
        ("health.changed", None, "good"),
        ("health.changed", "good", "failure"),
    ]
    assert items[1]["data"]["reasons"] == ["camera c02 is lost"]


async def test_alarms_are_evaluated_without_anyone_asking(store: Store) -> None:
    log = EventLog(store)
    alarming = Alarming(await open_alarms(store, log), log)
    broken = HealthCheck(status=CheckStatus.FAIL, detail="3 triggers in a row without any image")
    alarming.look(replace(GOOD_HEALTH, checks={"trigger_line": broken}), 0.0)
    await log.written()
    items = (await store.read(events_after, 0, 100)).items
    assert [(item["type"], item["subject"]) for item in items] == [
        ("alarm.raised", "trigger_line"),
        ("health.changed", "device"),
    ]
    assert items[0]["data"]["priority"] == "urgent"
