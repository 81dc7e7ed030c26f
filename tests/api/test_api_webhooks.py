"""Webhooks over REST: what became of them, and what an operator does about it; secrets are never shown."""

from typing import Any

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of
from support.webhook_receiver import Receiver, answer

from service.store import Store
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent
from service.web.settings import ApiKey, ApiSettings, Scope

pytestmark = pytest.mark.usefixtures("webhooks")


async def document(answer: httpx.Response) -> dict[str, Any]:
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


async def test_endpoints_are_listed_without_what_is_secret(
    client: httpx.AsyncClient, receiver: Receiver, store: Store
) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=each, subject="L1") for each in (EventType.LOT_OPENED, EventType.LOT_CLOSED)))
    await log.written()
    answer = await client.get("/webhooks")
    assert (await document(answer))["items"] == [
        {
            "name": "mes",
            "url": f"http://127.0.0.1:{receiver.port}/hook",
            "events": ["lot.closed"],
            "after": 0,
            "waiting": 1,
            "attempts": 0,
            "failing_since": None,
            "next_attempt_at": None,
            "last_problem": None,
            "last_taken_at": None,
            "disabled_at": None,
        }
    ]
    assert "whsec" not in answer.text
    assert "hidden" not in answer.text


async def test_a_test_says_what_came_of_it_and_is_in_the_history(
    client: httpx.AsyncClient, receiver: Receiver
) -> None:
    receiver.answer_next(answer(404))
    refused = await document(await client.post("/webhooks/mes/test"))
    assert (refused["status"], refused["problem"]) == (404, "HTTP 404 Not Found")
    taken = await document(await client.post("/webhooks/mes/test"))
    assert (taken["status"], taken["problem"], taken["type"]) == (204, None, "webhook.test")
    found = (await document(await client.get("/webhooks/mes/deliveries")))["items"]
    assert found == [taken, refused]
    assert (await document(await client.get("/webhooks/mes/deliveries?limit=1")))["items"] == [taken]
    assert receiver.ids == [refused["webhook_id"], taken["webhook_id"]]


async def test_enabling_and_replaying_are_in_the_audit(client: httpx.AsyncClient) -> None:
    enabled = await document(await client.post("/webhooks/mes/enable"))
    assert (enabled["disabled_at"], enabled["attempts"]) == (None, 0)
    assert (await document(await client.post("/webhooks/mes/replay", json={"after": 0})))["after"] == 0
    entries = (await document(await client.get("/audit")))["items"]
    assert [(each["action"], each["subject"], each["who"]) for each in entries] == [
        ("webhook enabled", "mes", "this machine"),
        ("webhook replayed", "mes", "this machine"),
    ]
    assert_problem(await client.post("/webhooks/mes/replay", json={"after": 1}), 409, "cursor-ahead")
    for wrong in ({"after": -1}, {"after": "0"}, {}, {"after": 0, "until": 1}):
        assert_problem(await client.post("/webhooks/mes/replay", json=wrong), 422, "invalid-request")


async def test_what_is_gone_cannot_be_replayed(client: httpx.AsyncClient, store: Store) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=EventType.LOT_CLOSED, subject="L1") for _ in range(5)))
    await log.written()
    await store.write(lambda connection: connection.execute("DELETE FROM events WHERE seq < 4") and None)
    refused = await client.post("/webhooks/mes/replay", json={"after": 2})
    assert_problem(refused, 410, "cursor-expired")
    assert (refused.json()["first_seq"], refused.json()["last_seq"]) == (4, 5)
    assert (await document(await client.post("/webhooks/mes/replay", json={"after": 3})))["waiting"] == 2


async def test_an_endpoint_that_is_not_configured_is_unknown(client: httpx.AsyncClient) -> None:
    assert_problem(await client.get("/webhooks/erp/deliveries"), 404, "unknown-webhook")
    for action in ("enable", "test"):
        assert_problem(await client.post(f"/webhooks/erp/{action}"), 404, "unknown-webhook")
    assert_problem(await client.post("/webhooks/erp/replay", json={"after": 0}), 404, "unknown-webhook")
    assert_problem(await client.post("/webhooks/a%20b/test"), 422, "invalid-request")


async def test_all_of_it_needs_the_scope_to_configure(store: Store, control: FakeControl) -> None:
    operator = ApiKey(
        name="mes",
        sha256="ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb",  # of `a`
        scopes=(Scope.READ, Scope.OPERATE),
    )
    headers = {"Authorization": "Bearer a"}
    async with client_of(app_of(store, control, ApiSettings(keys=(operator,)))) as client:
        for method, path in (
            ("GET", ""),
            ("GET", "/mes/deliveries"),
            ("POST", "/mes/enable"),
            ("POST", "/mes/test"),
            ("POST", "/mes/replay"),
            ("POST", "/erp/test"),
        ):
            assert_problem(await client.request(method, f"/webhooks{path}"), 401, "unauthorized")
            refused = await client.request(method, f"/webhooks{path}", headers=headers)
            assert_problem(refused, 403, "forbidden")
