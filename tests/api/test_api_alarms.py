"""Alarms over REST: what needs somebody, what to do, who has seen it."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.base.messages import Code, message
from service.base.status import CheckStatus, HealthCheck, health_check
from service.health.alarms.alarms import Alarms, open_alarms
from service.store import Store
from service.store.event_log import EventLog
from service.web.settings import ApiKey, ApiSettings, Scope

PASS, WARN, FAIL = CheckStatus.PASS, CheckStatus.WARN, CheckStatus.FAIL
QUARANTINE, RECORDING, TRIGGER_LINE = "quarantine", "recording", "trigger_line"
"""Checks that are alarms at once: these tests do not wait."""


def checks(**statuses: CheckStatus) -> dict[str, HealthCheck]:
    return {name: HealthCheck(status=status, detail=f"{name} says so") for name, status in statuses.items()}


async def get(client: httpx.AsyncClient, path: str, **parameters: str | int) -> dict[str, Any]:
    answer = await client.get(path, params=parameters)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


async def event_types(client: httpx.AsyncClient) -> list[tuple[str, str]]:
    items = (await get(client, "/events"))["items"]
    assert [item["seq"] for item in items] == list(range(1, len(items) + 1))
    return [(item["type"], item["subject"]) for item in items]


async def test_alarms_are_listed_by_priority_with_what_to_do(
    client: httpx.AsyncClient, alarms: Alarms
) -> None:
    assert await get(client, "/alarms") == {"items": [], "shelved": [], "suppressed": []}
    alarms.update(checks(quarantine=WARN, trigger_line=FAIL, archive=WARN, recording=WARN))
    items = (await get(client, "/alarms"))["items"]
    assert [(item["check"], item["priority"]) for item in items] == [
        (TRIGGER_LINE, "urgent"),
        (RECORDING, "low"),
        (QUARANTINE, "low"),
    ]
    first = items[0]
    assert (first["state"], first["detail"], first["occurrences"]) == (
        "unacknowledged",
        "trigger_line says so",
        1,
    )
    assert first["cause"].startswith("The gate announces stones and no camera exposes")
    assert first["action"].startswith("Check the trigger line")
    german = (await get(client, "/alarms", language="de"))["items"][0]
    assert german["action"].startswith("Triggerleitung")
    assert_problem(await client.get("/alarms?language=fr"), 422, "invalid-request")


async def test_what_a_check_says_is_coded_and_worded_in_the_language_and_outlives_a_restart(
    client: httpx.AsyncClient, store: Store, control: FakeControl, alarms: Alarms
) -> None:
    said = message(Code.TRIGGER_LINE_BLIND, triggers=5)
    alarms.update({TRIGGER_LINE: health_check(said, fail=True)})
    await client.post("/alarms/1/acknowledge")  # which is answered when it is written
    control.alarms = await open_alarms(store, EventLog(store))
    english, german = [
        (await get(client, "/alarms", language=language))["items"][0] for language in ("en", "de")
    ]
    assert english["detail"] == english["said"] == german["detail"] == said
    coded = {"code": "trigger_line_blind", "subjects": [], "parameters": {"triggers": 5}}
    assert english["findings"] == german["findings"] == [coded]
    assert german["said"].startswith("5 Auslösungen hintereinander ohne ein einziges Bild")
    events = (await get(client, "/events"))["items"]
    assert [event["data"]["findings"] for event in events] == [[coded]] * 2


async def test_somebody_takes_note_and_the_audit_says_who(
    client: httpx.AsyncClient, alarms: Alarms, store: Store
) -> None:
    alarms.update(checks(trigger_line=FAIL))
    answer = await client.post("/alarms/1/acknowledge")
    assert (answer.status_code, answer.json()["state"]) == (200, "acknowledged")
    assert answer.json()["acknowledged_by"] == "this machine"
    assert (await client.post("/alarms/1/acknowledge")).json() == answer.json()
    (entry,) = (await get(client, "/audit"))["items"]
    assert (entry["action"], entry["subject"], entry["who"]) == (
        "alarm acknowledged",
        TRIGGER_LINE,
        "this machine",
    )
    assert (entry["before"]["state"], entry["after"]["state"]) == ("unacknowledged", "acknowledged")
    assert await event_types(client) == [
        ("alarm.raised", TRIGGER_LINE),
        ("alarm.acknowledged", TRIGGER_LINE),
    ]
    assert_problem(await client.post("/alarms/2/acknowledge"), 404, "unknown-alarm")
    assert_problem(await client.post("/alarms/x/acknowledge"), 422, "invalid-request")


async def test_an_alarm_is_put_aside_and_taken_back(client: httpx.AsyncClient, alarms: Alarms) -> None:
    alarms.update(checks(quarantine=WARN))
    shelf = {"minutes": 30, "reason": "sent to the maker"}
    for wrong in (
        {**shelf, "minutes": 1441},
        {**shelf, "minutes": 0},
        {**shelf, "reason": ""},
        {"minutes": 5},
    ):
        assert_problem(await client.post("/alarms/1/shelve", json=wrong), 422, "invalid-request")
    shelved = (await client.post("/alarms/1/shelve", json=shelf)).json()
    assert (shelved["state"], shelved["shelf_reason"]) == ("shelved", "sent to the maker")
    assert shelved["shelved_until"] > shelved["changed_at"]
    found = await get(client, "/alarms")
    assert (found["items"], [item["id"] for item in found["shelved"]]) == ([], [1])
    assert_problem(await client.post("/alarms/1/acknowledge"), 409, "alarm-conflict")
    back = (await client.post("/alarms/1/unshelve")).json()
    assert (back["state"], back["shelved_until"]) == ("unacknowledged", None)
    assert_problem(await client.post("/alarms/1/unshelve"), 409, "alarm-conflict")
    assert_problem(await client.post("/alarms/7/shelve", json=shelf), 404, "unknown-alarm")
    assert_problem(await client.post("/alarms/7/unshelve"), 404, "unknown-alarm")
    actions = [entry["action"] for entry in (await get(client, "/audit"))["items"]]
    assert actions == ["alarm shelved", "alarm unshelved"]
    assert [kind for kind, _ in await event_types(client)] == [
        "alarm.raised",
        "alarm.shelved",
        "alarm.raised",
    ]


async def test_a_dead_switch_is_one_alarm(client: httpx.AsyncClient, alarms: Alarms) -> None:
    alarms.update(checks(cameras=FAIL, trigger_line=FAIL))
    found = await get(client, "/alarms")
    assert (found["items"], [item["check"] for item in found["suppressed"]]) == ([], [TRIGGER_LINE])
    assert_problem(await client.post("/alarms/1/acknowledge"), 409, "alarm-conflict")


async def test_alarms_and_their_shelf_outlive_a_restart(
    client: httpx.AsyncClient, alarms: Alarms, store: Store, control: FakeControl
) -> None:
    alarms.update(checks(quarantine=WARN, trigger_line=FAIL))
    await client.post("/alarms/1/acknowledge")
    await client.post("/alarms/2/shelve", json={"minutes": 60, "reason": "known"})
    before = await get(client, "/alarms")
    control.alarms = await open_alarms(store, EventLog(store))
    assert await get(client, "/alarms") == before
    control.alarms.update(checks(quarantine=WARN, trigger_line=FAIL))
    assert await get(client, "/alarms") == before


async def test_the_history_has_all_of_them_page_by_page(
    client: httpx.AsyncClient, alarms: Alarms, store: Store
) -> None:
    log = EventLog(store)
    alarms.update(checks(quarantine=WARN, recording=WARN, trigger_line=FAIL))
    await log.written()
    await client.post("/alarms/3/acknowledge")  # and all that was noted before is written
    page = await get(client, "/alarms/history", limit=2, language="de")
    assert ([item["id"] for item in page["items"]], page["next_before"]) == ([3, 2], 2)
    assert page["items"][0]["cause"].startswith("Die Lichtschranke meldet")
    rest = await get(client, "/alarms/history", limit=2, before=2)
    assert ([item["id"] for item in rest["items"]], rest["next_before"]) == ([1], None)
    (only,) = (await get(client, "/alarms/history", check=TRIGGER_LINE))["items"]
    assert (only["state"], only["ended_at"]) == ("acknowledged", None)


@pytest.fixture
async def keyed(store: Store, control: FakeControl, tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    reader = ApiKey(
        name="mes",
        sha256="ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb",  # of `a`
        scopes=(Scope.READ,),
    )
    async with client_of(app_of(store, control, ApiSettings(keys=(reader,)))) as client:
        yield client


@pytest.mark.usefixtures("alarms")
async def test_reading_needs_a_key_and_acting_the_scope_to_operate(keyed: httpx.AsyncClient) -> None:
    for path in ("/alarms", "/alarms/history", "/events", "/events/stream", "/results/stream"):
        assert_problem(await keyed.get(path), 401, "unauthorized")
    headers = {"Authorization": "Bearer a"}
    assert (await keyed.get("/alarms", headers=headers)).status_code == 200
    for action in ("acknowledge", "unshelve"):
        assert_problem(await keyed.post(f"/alarms/1/{action}", headers=headers), 403, "forbidden")
